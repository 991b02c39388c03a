"""The contract of a method: parameters, demands on a kernel, offers for a tolerance, sums."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from treecode import check
from treecode.kernels.base import MEMBERS, Kernel
from treecode.ranks import OneRank

PRECISIONS = "float64", "float32"


class Parameter(NamedTuple):
    """The allowed values of one parameter.

    Attributes
    ----------
    check : function
        Of a name for the message and a value: returns the value, or refuses it with a ValueError or
        a TypeError.
    default : optional
        The value if none is given; None if the sum finds it.
    required : bool
        Whether a `Choice` must have it.
    """

    check: Callable[[str, Any], Any]
    default: Any = None
    required: bool = False


# The keywords of `treecode.Plan`, as most methods have them. A keyword that a method does not
# declare must be in this range, and is ignored.
KEYWORDS: Mapping[str, Parameter] = {
    "theta": Parameter(partial(check.number, low=0.0, high=1.0), 0.7, True),
    "degree": Parameter(partial(check.integer, low=1, high=40), 7, True),
    "leaf_size": Parameter(partial(check.integer, low=1), 2000, True),
    "precision": Parameter(partial(check.one_of, allowed=PRECISIONS), PRECISIONS[0]),
    "tol": Parameter(partial(check.number, low=1e-13, high=1.0), 1e-5, True),
}


class Offer(NamedTuple):
    """A sum that a method can make, with its expected error and time.

    Attributes
    ----------
    parameters : mapping
        JSON can hold them: numbers and texts.
    error : float
        Relative error, K eq. (8.1), of the worst of `accuracy.Parts`.
    seconds : float
        On one thread, for one set of strengths, with its share of the work done once for all.
    kind : str, optional
        Sums of one kind err alike: a sample of one tells how far expectations of all are off.
    """

    parameters: Mapping[str, Any]
    error: float
    seconds: float
    kind: str = ""


class Case(Protocol):
    """Points, strengths and a tolerance for which sums are offered, with measurements of them.

    Attributes
    ----------
    kernel : Kernel
    sources, targets : (3, N) and (3, M) float64
        The same array if the targets are the sources.
    tol : float
        The tolerance that is asked for.
    sums : int
        Number of sums that are to share the work done once for all of them.
    scale : float
        By how much errors are larger here than the model says; measured at first use.
    rounding : dict of float
        Error that each of `PRECISIONS` makes by rounding; measured at first use.
    memory : dict
        Results that a method keeps for this case, under its name.
    """

    kernel: Kernel
    sources: np.ndarray
    targets: np.ndarray
    tol: float
    sums: int
    memory: dict[str, Any]

    @property
    def scale(self) -> float: ...

    @property
    def rounding(self) -> Mapping[str, float]: ...

    def fitted(self, name: str) -> dict[str, Any] | None:
        """Return the numbers fitted to a method's costs and errors; None where there are none."""

    def will_do(self, name: str, offer: Offer) -> bool:
        """Tell whether an offer should keep the tolerance, after the samples so far."""

    def of_terms(self) -> Sequence[Case]:
        """Return a case for each term of a kernel within a boundary.

        Their errors are expected to be those of the kernel in free space.
        """


class Sum(Protocol):
    """A sum by one method with given parameters, for points that are set once and many strengths.

    The place and the order of its computations are free: arrays that it takes and returns are
    NumPy's, and its own may be elsewhere.

    Attributes
    ----------
    parameters : mapping
        Parameters in use, also those found for the points if a later sum has to begin with them.
    seconds : dict of float
        By stage, of the last `set_points` and `execute`.
    effort : float
        Work of the last sum, in pairs of points.
    sources, targets : (3, N) and (3, M) float64
        The points, in any order; one array if the targets are the sources.
    source_order, target_order : (N,) and (M,) int
        Which of the points that were set stands at each place.
    ranks : treecode.ranks.OneRank
        A sum need not have it. If several ranks share the targets, each has a sum of all sources at
        some of the targets, which is told of the ranks before it gets points. It may then share
        other work too: its calls are made on all ranks alike. It promises that its values at a
        target do not depend on which others are with it.
    """

    @property
    def parameters(self) -> Mapping[str, Any]: ...

    @property
    def seconds(self) -> Mapping[str, float]: ...

    @property
    def effort(self) -> float: ...

    @property
    def sources(self) -> np.ndarray: ...

    @property
    def targets(self) -> np.ndarray: ...

    @property
    def source_order(self) -> np.ndarray: ...

    @property
    def target_order(self) -> np.ndarray: ...

    def set_points(self, sources: np.ndarray, targets: np.ndarray | None) -> None:
        """Take points, (3, N) and (3, M) or None for the sources; the arrays are its own now.

        A ValueError says why a kernel or points are not taken.
        """

    def execute(self, strengths: np.ndarray) -> np.ndarray:
        """Return the sum, (M, value_size), of strengths (N, strength_size), in the user's order."""

    def info(self) -> dict[str, Any]:
        """Return parameters, the last sum's `near_pairs` and `far_pairs` (or None), `bytes`."""


class Method:
    """The contract of a method of summation; docs/add-a-method.md is a guide.

    A subclass has a `name`, declares its `parameters`, and makes sums. By `offers` it takes part
    in backend "auto". An instance is handed to `treecode.methods.register`, and has no state.

    Attributes
    ----------
    name : str
        As `backend` of a plan.
    parameters : mapping of str to Parameter
        Parameters that a `Choice` of this method may have. Other keywords of `treecode.Plan`, if
        they are in `KEYWORDS`, are ignored.
    members : tuple of str
        Attributes that a kernel must have; the members of `treecode.Kernel` by default.
    any_kernel : bool
        Whether every kernel with these members is taken; if not, `Sum.set_points` refuses some.

    Examples
    --------
    >>> import treecode as tc
    >>> class Exact(tc.Method):
    ...     name = "exact"
    ...
    ...     def make(self, kernel, parameters, progress=False):
    ...         return tc.EXACT.sum(kernel, progress)
    >>> tc.methods.register(Exact())
    >>> kernel, points, forces = tc.RegularizedStokeslet(epsilon=0.1), [[0, 0, 0]], [[1, 0, 0]]
    >>> print(tc.evaluate(kernel, points, forces, backend="exact").round(4))
    [[0.7958 0.     0.    ]]
    """

    name: ClassVar[str]
    parameters: ClassVar[Mapping[str, Parameter]] = {}
    members: ClassVar[tuple[str, ...]] = MEMBERS
    any_kernel: ClassVar[bool] = True

    def takes(self, kernel: Kernel) -> bool:
        """Tell whether a kernel has all members that are asked for."""
        return all(hasattr(kernel, member) for member in self.members)

    def complete(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return a value for each parameter: the given one, or else its default if it has one."""
        values = {name: given.get(name, p.default) for name, p in self.parameters.items()}
        return {name: value for name, value in values.items() if value is not None}

    def refuse(self, given: Mapping[str, Any]) -> None:
        """Refuse keywords of a plan that do not go together; a ValueError names one."""

    def seeks(self, given: Mapping[str, Any]) -> bool:
        """Tell whether `tol` of a plan is to be kept: by samples, and by offers where it is not."""
        return "tol" in given

    def first(self, given: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return the parameters to begin with; None if the offers are to tell."""
        return self.complete(given)

    def offers(self, case: Case, given: Mapping[str, Any]) -> Iterable[Offer]:
        """Return sums with their expected errors and times, none by default.

        This is asked anew after each sum that was tried, because `Case.will_do` may have changed.

        Parameters
        ----------
        case : Case
        given : mapping
            Keywords of a plan that are not to be chosen; empty in backend "auto".
        """
        return ()

    def make(self, kernel: Kernel, parameters: Mapping[str, Any], progress: bool = False) -> Sum:
        """Return a sum without points.

        Parameters
        ----------
        kernel : Kernel
        parameters : mapping
            As `complete` returns them.
        progress : bool, optional
            Show a progress bar while summing.
        """
        raise NotImplementedError(f"{type(self).__qualname__} must have the method make")

    def across(
        self, kernel: Kernel, parameters: Mapping[str, Any], ranks: OneRank, progress: bool = False
    ) -> Sum | None:
        """Return a sum without points of which each rank has some; None if there is no such sum.

        Each rank sets points of its own, as many as it likes, gives their strengths, and gets the
        values at its targets. `sources`, `targets` and their orders are not looked at.
        """
        return None

    def describe(self, parameters: Mapping[str, Any]) -> str:
        """Return the name with the parameters that matter, for logs."""
        return self.name
