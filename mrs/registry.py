"""Things that users call by a name: kinds of bodies and forces, integrators, formats of files."""

from __future__ import annotations

from typing import Any, TypeVar

Thing = TypeVar("Thing")


class Registry(dict[str, Thing]):
    """Things by name, to which a user's program can add.

    Parameters
    ----------
    role : str
        The word for such a thing in messages, for example "integrator".
    attribute : str
        Where a thing says its name: "name" or "kind".

    Examples
    --------
    >>> import mrs
    >>> "rods" in mrs.BODIES, "wall" in mrs.BOUNDARIES, "rkc2" in mrs.INTEGRATORS
    (True, True, True)
    >>> "vtkhdf" in mrs.FORMATS, "flux" in mrs.OBSERVABLES
    (True, True)
    >>> @mrs.FORCES.register
    ... class Lift(mrs.UserForce):  # in TOML: lift = { body = "rods", strength = 1.0 }
    ...     kind = "lift"
    ...
    ...     def __init__(self, body: str, strength: float):
    ...         super().__init__(body, lambda time, points, state: (0.0, 0.0, strength))
    >>> "lift" in mrs.FORCES
    True
    """

    def __init__(self, role: str, attribute: str) -> None:
        super().__init__()
        self._role, self._attribute = role, attribute

    def register(self, thing: Thing) -> Thing:
        """Add a thing, and return it; usable as a decorator of a class.

        Raises
        ------
        ValueError
            If it has no name, or if another one has that name.
        """
        name = getattr(thing, self._attribute, None)
        if not isinstance(name, str) or not name.isidentifier():
            raise ValueError(
                f"{self._role}.{self._attribute} must be a text that can be a name in Python, "
                f"got {name!r}"
            )
        if not _same(self.get(name, thing), thing):
            raise ValueError(f"{self._role} {name!r} is registered already")
        self[name] = thing
        return thing


def _same(one: Any, other: Any) -> bool:
    """Return whether both are one thing, or of one class whose file was loaded again."""
    kinds = [thing if isinstance(thing, type) else type(thing) for thing in (one, other)]
    names = {(kind.__module__, kind.__qualname__) for kind in kinds}
    return one is other or (kinds[0] is not kinds[1] and len(names) == 1)
