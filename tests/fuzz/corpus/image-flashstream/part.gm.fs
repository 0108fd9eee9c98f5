; Written by hand, in the manner of TI's tools; the key is the default.
W: AA 00 00 80
W: AA 00 00 80
X: 10
W: AA 00 01 00
C: AA 00 21 04
W: AA 00 02 00
C: AA 00 09 01
W: AA 00 13 00
X: 1100
W: AA 61 00
W: AA 3E 44 00
W: AA 40 00 00 00 00 00 00 00 00 03 08 98 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00
W: AA 60 5C
X: 10
W: AA 3E 44 00
C: AA 60 5C
W: AA 00 42 00
X: 2000
