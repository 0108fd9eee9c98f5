; Written by hand.
W: AA 00 00 0F
X: 1000
W: 16 00 0C 00 00 00 83 DE
