"""Beats of cilia and flagella as they are published: Fourier series in time along a centreline."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mrs import check
from mrs.bodies.surfaces import Surface, slender

_PUBLISHED = Path(__file__).with_name("published")
_ORDER = 4  # of the Gauss-Legendre rule between two points
_LEAST = 0.1  # rate of the fitted length along s, below which it has no direction
_PHASES = 64  # of a period, at which that is looked at


@check.spelling
class Beat:
    """A beat given by a table: a Fourier series in time, with polynomials along the centreline.

    Parameters
    ----------
    cosine, sine : (n, m, 3) array_like
        Coefficients of mode 0, 1, ... and of power 0, 1, ... of the arclength; those of sines of
        mode 0 have no effect.
    length : float
        Of the centreline.
    period : float
    thickness : float
        Radius of the body. The blob size is sqrt(e) times that, which gives its drag.
    spacing : float, optional
        Between points, in blob sizes.

    Attributes
    ----------
    surface : Surface
        At time zero.
    length, period : float

    Raises
    ------
    ValueError, TypeError
        The message names the argument and the allowed values.

    Notes
    -----
    The table is a fit x(s, t) = sum_n [A_n(s) cos(2 pi n t / T) + B_n(s) sin(2 pi n t / T)] with
    polynomials A_n and B_n in s, from 0 to 1 (J. R. Blake, J. Fluid Mech. 55, 1, 1972). Fits keep
    the length to some per cent only. A cilium does not stretch: only the directions of the fit are
    taken, X(s, t) = L [x(0, t) + int_0^s x' / |x'| ds]. A fit that keeps the length is unchanged.
    Points are the middles of equal pieces of s. Velocities are exact.

    Examples
    --------
    >>> import mrs
    >>> beat = mrs.Beat.read("lung_cilium", length=1.0, period=1.0, thickness=0.05)
    >>> for time in (0.0, 0.25, 0.5, 0.75):
    ...     print(beat.points(time)[-1].round(2))  # near the tip
    [-0.51  0.    0.82]
    [0.66 0.   0.7 ]
    [0.48 0.   0.63]
    [-0.04  0.    0.76]
    """

    def __init__(
        self,
        cosine: ArrayLike,
        sine: ArrayLike,
        *,
        length: float,
        period: float,
        thickness: float,
        spacing: float = 0.3,
    ) -> None:
        modes, powers, _ = (*np.shape(cosine), 1, 1, 1)[:3]
        self.cosine, self.sine = (
            check.shaped(name, value, (modes, powers, 3))
            for name, value in (("cosine", cosine), ("sine", sine))
        )
        self.length = check.positive("length", length)
        self.period = check.positive("period", period)
        count, epsilon = slender(self.length, thickness, spacing)
        edges = np.concatenate([[0.0], (np.arange(count) + 0.5) / count])
        nodes, weights = np.polynomial.legendre.leggauss(_ORDER)
        steps = np.diff(edges)[:, None]
        self._weights = 0.5 * steps * weights
        s = (edges[:-1, None] + 0.5 * steps * (1.0 + nodes)).ravel()
        power = np.arange(powers)
        slopes = power * s[:, None] ** np.maximum(power - 1, 0)
        both = np.stack([self.cosine, self.sine])
        self._bases = both[:, :, 0].reshape(2 * modes, 3)
        self._slopes = np.einsum("qm,cnmi->cnqi", slopes, both).reshape(2 * modes, -1)
        self._require_directions()
        self.surface = Surface(self.points(0.0), epsilon, (np.arange(count),))

    @classmethod
    @check.spelling
    def read(
        cls,
        path: str | os.PathLike[str],
        *,
        length: float,
        period: float,
        thickness: float,
        spacing: float = 0.3,
    ) -> Beat:
        """Return a beat whose coefficients are in a file.

        Parameters
        ----------
        path : path
            A line for each mode n and power m, with eight numbers between commas: n, m, A_nm along
            x, y and z, and B_nm likewise. Lines that are left out are zero. Text after # is a
            comment. Or the name of a beat that comes with this package: "lung_cilium", of which the
            effective stroke is along x.
        length, period, thickness, spacing
            As for `Beat`.

        Raises
        ------
        ValueError
            If the file does not hold this.
        """
        known = {file.stem: file for file in _PUBLISHED.glob("*.csv")}
        table = np.loadtxt(known.get(str(path), Path(path)), delimiter=",", ndmin=2)
        places = table[:, :2].astype(int)
        if table.shape[1] != 8 or (places != table[:, :2]).any() or places.min() < 0:
            raise ValueError(f"{path} must have lines of n, m from 0 and of six more numbers")
        if len(np.unique(places, axis=0)) < len(places):
            raise ValueError(f"{path} must have one line for each n and m")
        both = np.zeros((2, *(places.max(axis=0) + 1), 3))
        both[:, places[:, 0], places[:, 1]] = table[:, 2:].reshape(-1, 2, 3).swapaxes(0, 1)
        return cls(*both, length=length, period=period, thickness=thickness, spacing=spacing)

    def _harmonics(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the cosines of all modes, then the sines; and their rates of change."""
        rate = 2.0 * np.pi / self.period * np.arange(len(self.cosine))
        cosine, sine = np.cos(rate * time), np.sin(rate * time)
        return np.append(cosine, sine), np.append(-rate * sine, rate * cosine)

    def _integrated(self, values: np.ndarray) -> np.ndarray:
        """Return the integrals of values, (q, 3), from the base to the points, (p, 3)."""
        pieces = self._weights[..., None] * values.reshape(*self._weights.shape, 3)
        return np.cumsum(pieces.sum(axis=1), axis=0)

    def points(self, time: float) -> np.ndarray:
        """Return the points, (p, 3)."""
        harmonics, _ = self._harmonics(time)
        slope = (harmonics @ self._slopes).reshape(-1, 3)
        direction = slope / np.linalg.norm(slope, axis=1)[:, None]
        return self.length * (harmonics @ self._bases + self._integrated(direction))

    def velocities(self, time: float) -> np.ndarray:
        """Return the velocities of the points, (p, 3)."""
        harmonics, rates = self._harmonics(time)
        slope, change = (np.reshape(h @ self._slopes, (-1, 3)) for h in (harmonics, rates))
        size = np.linalg.norm(slope, axis=1)[:, None]
        direction = slope / size
        along = np.einsum("qi,qi->q", direction, change)[:, None]
        turning = (change - along * direction) / size
        return self.length * (rates @ self._bases + self._integrated(turning))

    def _require_directions(self) -> None:
        """Refuse a fit that stands still along s, as at a cusp: it has no direction there."""
        for time in self.period * np.arange(_PHASES) / _PHASES:
            slope = (self._harmonics(time)[0] @ self._slopes).reshape(-1, 3)
            least = np.linalg.norm(slope, axis=1).min()
            if not least >= _LEAST:
                raise ValueError(
                    "cosine and sine must give a centreline of about length 1, with |dx/ds| of at "
                    f"least {_LEAST:g}, got {least:.3g} at time {time:g}"
                )
