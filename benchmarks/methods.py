"""The methods that benchmarks compare, as they are named in rows and tables."""

from treecode.methods import direct, ewald, fmm, kitc, taylor

DIRECT, KITC, TAYLOR, FMM = direct.NAME, kitc.NAME, taylor.NAME, fmm.NAME
EWALD = ewald.NAME
