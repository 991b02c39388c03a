"""The choice of backend "auto": a tolerance is the one knob, the cheapest sum is found for it.

At the first sum over some points

* a treecode of low degree beside direct sums at a few targets tells how errors for these points
  and strengths compare with those of the model, single precision what its rounding does to them
  (`probe`);
* the methods offer sums, with errors and seconds from the fitted model (`model`), and the cheapest
  that should reach the tolerance is made (`search`);
* its error is sampled (`sampling`): if it is too large a more accurate sum is made instead, and if
  it leaves room for one that is cheaper, and many are to follow, that is tried.

No time is measured: what is chosen depends on kernel, points and strengths alone.
"""
