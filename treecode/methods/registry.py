"""Methods of summation by name, and a choice: the name of one with its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from treecode import check
from treecode.boundaries.base import Boundary, BoundedKernel
from treecode.boundaries.within import Within
from treecode.kernels.base import Kernel
from treecode.methods.base import KEYWORDS, Method, Parameter, Sum

AUTO = "auto"  # in the place of a name: any method, by tolerance

_methods: dict[str, Method] = {}


def register(method: Method) -> None:
    """Make a method known by its name, to plans and to simulations.

    Parameters
    ----------
    method : Method
        An instance. It takes the place of an earlier one of the same class, as in a notebook.

    Raises
    ------
    TypeError
        If it is not a `Method`, or has no name.
    ValueError
        If another class has the name.

    Examples
    --------
    >>> import treecode as tc
    >>> class Exact(tc.Method):
    ...     name = "exact"
    ...
    ...     def make(self, kernel, parameters, progress=False):
    ...         return tc.EXACT.sum(kernel, progress)
    >>> tc.methods.register(Exact())
    >>> "exact" in tc.backends()
    True
    """
    if not isinstance(method, Method) or not isinstance(getattr(method, "name", None), str):
        raise TypeError(f"method must be an instance of a treecode.Method, got {method!r}")
    known = type(_methods.get(method.name, method))
    own = type(method)
    same = (known.__module__, known.__qualname__) == (own.__module__, own.__qualname__)
    if method.name == AUTO or not same:
        taken = ", ".join(map(repr, (AUTO, *_methods)))
        raise ValueError(f"name of a method must be none of {taken}, got {method.name!r}")
    _methods[method.name] = method


def names() -> tuple[str, ...]:
    """Return the names of all methods, in the order in which they were registered.

    Examples
    --------
    >>> import treecode as tc
    >>> tc.methods.names()[:2]
    ('direct', 'kitc')
    """
    return tuple(_methods)


def backends() -> tuple[str, ...]:
    """Return all that `backend` of a plan may be: "auto", and the names of the methods.

    Examples
    --------
    >>> import treecode as tc
    >>> {"auto", "direct", "kitc", "taylor", "fmm", "ewald"} <= set(tc.backends())
    True
    """
    return AUTO, *names()


def get(name: str, argument: str = "backend") -> Method:
    """Return the method of a name; the error of an unknown one names `argument` and lists all.

    Examples
    --------
    >>> import treecode as tc
    >>> tc.methods.get("fmm").any_kernel  # isotropic ones only
    False
    """
    return _methods[check.one_of(argument, name, names())]


def parameters(backend: str) -> Mapping[str, Parameter]:
    """Return the parameters that a method declares; "auto" has none, it chooses them.

    Examples
    --------
    >>> import treecode as tc
    >>> tc.methods.parameters("kitc")["degree"].default
    7
    """
    return {} if backend == AUTO else get(backend).parameters


def method_for(kernel: Any, name: str) -> Method:
    """Return the method of a name for a kernel, which may be one within a boundary."""
    method = get(name)
    return Within(method, kernel) if isinstance(kernel, BoundedKernel) else method


def able(kernel: Any) -> tuple[Method, ...]:
    """Return the methods whose demands a kernel meets; a sum may refuse it later."""
    methods = (method_for(kernel, name) for name in names())
    return tuple(method for method in methods if method.takes(kernel))


def require_kernel(kernel: Any, backend: str) -> Any:
    """Return `kernel` if the method takes it, or any method for "auto".

    Raises
    ------
    TypeError
        With the missing members, and the methods that take any kernel.
    """
    methods = tuple(_methods.values()) if backend == AUTO else (get(backend),)
    taken = any(method.takes(kernel) for method in methods)
    members = () if taken else Method.members if backend == AUTO else methods[0].members
    others = [name for name, method in _methods.items() if method.any_kernel]
    if isinstance(kernel, BoundedKernel):
        for term in kernel.terms:
            require_kernel(term.kernel, backend)
        return kernel
    return check.kernel(kernel, backend, members, others)


def require_within(kernel: Any, backend: str, boundary: Boundary) -> None:
    """Refuse a backend that cannot sum within a boundary, where `kernel` is summed."""
    able_names = [method.name for method in able(kernel)]
    if backend != AUTO and backend not in able_names:
        allowed = ", ".join(map(repr, able_names))
        raise ValueError(
            f"backend must be {allowed} or {AUTO!r} within {boundary}, got {backend!r}"
        )


def checked_keywords(backend: str, keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords of a plan that are not None, in the ranges that the method declares."""
    declared = {**KEYWORDS, **parameters(backend)}
    given = {name: value for name, value in keywords.items() if value is not None}
    return {name: declared[name].check(name, value) for name, value in given.items()}


class Choice:
    """A method and its parameters: compared, hashed and printed as one value.

    Parameters
    ----------
    backend : str
        The name of a method.
    **parameters
        Numbers and texts; None for one that is not given.

    Examples
    --------
    >>> import treecode as tc
    >>> choice = tc.Choice("kitc", theta=0.7, degree=7, leaf_size=2000)
    >>> print(choice, tc.EXACT)
    kitc(0.7/7) direct
    >>> tc.Choice(**choice.as_dict()) == choice
    True
    """

    __slots__ = ("_items", "backend")

    def __init__(self, backend: str, **parameters: Any) -> None:
        self.backend = backend
        self._items = tuple(sorted((k, v) for k, v in parameters.items() if v is not None))

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters that are given, by name."""
        return dict(self._items)

    def as_dict(self) -> dict[str, Any]:
        """Return the arguments that make this choice again, which JSON can hold."""
        return {"backend": self.backend, **self.parameters}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Choice):
            return NotImplemented
        return (self.backend, self._items) == (other.backend, other._items)

    def __hash__(self) -> int:
        return hash((self.backend, self._items))

    def __repr__(self) -> str:
        arguments = [repr(self.backend), *(f"{name}={value!r}" for name, value in self._items)]
        return f"Choice({', '.join(arguments)})"

    def __str__(self) -> str:
        method = _methods.get(self.backend)
        return method.describe(self.parameters) if method else self.backend

    def sum(self, kernel: Kernel, progress: bool = False) -> Sum:
        """Return the sum, without points yet."""
        method = get(self.backend)
        return method.make(kernel, method.complete(self.parameters), progress)


def require_complete(method: Method, values: Mapping[str, Any], prefix: str = "") -> None:
    """Refuse parameters among which one is missing that a sum must have."""
    for name, parameter in method.parameters.items():
        if parameter.required and name not in values:
            raise ValueError(
                f"{prefix}{name} must be given for backend {method.name!r}, got {dict(values)!r}"
            )


def require_choice(choice: Any, kernel: Kernel) -> Choice:
    """Return `choice` if it is one, has all parameters in their ranges, and is for a kernel.

    Raises
    ------
    ValueError, TypeError
        The message names the parameter as ``choice.theta``.
    """
    if not isinstance(choice, Choice):
        raise TypeError(f"choice must be a treecode.Choice, such as Plan.choice, got {choice!r}")
    get(choice.backend, "choice.backend")
    method = method_for(kernel, choice.backend)
    require_kernel(kernel, method.name)
    require_complete(method, choice.parameters, "choice.")
    for name, value in choice.parameters.items():
        if name not in method.parameters:
            check.absent(f"with backend {method.name!r}", **{f"choice.{name}": value})
        method.parameters[name].check(f"choice.{name}", value)
    return choice
