"""Bodies of a run as xarray has them: arrays with names for their axes, still in their files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mrs.output.extras import extra
from mrs.output.series import Series
from mrs.output.stored_body import StoredBody

if TYPE_CHECKING:
    import xarray as xr


def tree(bodies: Mapping[str, StoredBody], times: np.ndarray) -> xr.DataTree:
    """Return a Dataset for each body.

    Parameters
    ----------
    bodies : dict of StoredBody
    times : (frames,) float ndarray

    Raises
    ------
    ImportError
        If xarray is not installed.
    """
    xr = extra("xarray")
    return xr.DataTree.from_dict({name: dataset(body, times) for name, body in bodies.items()})


def dataset(body: StoredBody, times: np.ndarray) -> xr.Dataset:
    """Return the positions and all fields of a body.

    Parameters
    ----------
    body : StoredBody
    times : (frames,) float ndarray

    Raises
    ------
    ImportError
        If xarray is not installed.
    """
    xr = extra("xarray")
    positions = body.positions
    variables = {name: (body.dims(name), _lazy(body[name])) for name in body.fields}
    variables["positions"] = (positions.dims, _lazy(positions))
    axes = {"time": times, "xyz": list("xyz")}
    used = {dim for dims, _ in variables.values() for dim in dims}
    coords = {name: values for name, values in axes.items() if name in used}
    return xr.Dataset(variables, coords, {"name": body.name, "kind": body.kind})


def _lazy(values: Series | np.ndarray) -> Any:
    """Return an array of xarray that reads what is asked for."""
    if isinstance(values, np.ndarray):
        return values
    from xarray.backends import BackendArray
    from xarray.core import indexing

    class InFile(BackendArray):
        shape, dtype = values.shape, values.dtype

        def __getitem__(self, key: Any) -> np.ndarray:
            basic = indexing.IndexingSupport.BASIC
            return indexing.explicit_indexing_adapter(key, self.shape, basic, values.__getitem__)

    return indexing.LazilyIndexedArray(InFile())
