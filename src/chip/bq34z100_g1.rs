//! bq34z100-G1: Impedance Track gauge for 3 V to 65 V packs.
