;--------------------------------------------------------
;Verify Existing Firmware Version
;--------------------------------------------------------
W: AA 00 01 00
C: AA 00 27 04
W: AA 00 02 00
C: AA 00 02 02
;Data Block
W: AA 3E 53 00
W: AA 40 20 11 E0 E1 E2 E3 E4 E5 E6 E7 E8 E0 E1 E2 E3 E4 E5 E6 E7 E8 E0 E1 E2 E3 E4 E5 E6 E7 E8 E0 E1 E2
W: AA 60 1F
X: 10
W: AA 3E 53 00
C: AA 60 1F
W: AA 3E 40 00
W: AA 45 00 00 14 04
W: AA 60 00
X: 10
W: AA 00 00 00
W: AA 00 42 00
X: 2000
