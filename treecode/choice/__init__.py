"""The choice of backend "auto": the cheapest sum that keeps a given tolerance.

At the first sum over some points

* a treecode of low degree is compared with direct sums at a few targets: this shows how large
  errors are for these points and strengths, relative to the model; a sum in single precision shows
  the effect of its rounding (`probe`);
* the methods offer sums, with errors and seconds from the fitted model (`model`), and the cheapest
  that should reach the tolerance is made (`search`);
* its error is sampled (`sampling`): if it is too large, a more accurate sum is made instead; if it
  is so small that a cheaper sum may do, and many sums are to follow, the cheaper one is tried.

No time is measured: the choice depends on kernel, points and strengths alone.
"""
