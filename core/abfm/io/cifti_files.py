"""Writers of CIFTI files of one hemisphere, based on nibabel: scalars, labels and frames.

A CIFTI file lists the vertices that have values. Vertices without a value (NaN) are omitted, like
the medial wall in files of the Human Connectome Project.
"""

import os
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.errors import ResultError
from abfm.io.atomic import write_file
from abfm.io.source_estimates import even_step
from abfm.reading import STRUCTURES, Labels

CIFTI_VALUES = (".dscalar.nii", ".dtseries.nii")
CIFTI_LABELS = ".dlabel.nii"
_KEY_MAX = 1 << 24  # the largest integer up to which single precision is exact
_NO_COLOR = (0.5, 0.5, 0.5, 1.0)


def write_cifti_values(
    path: str | os.PathLike[str],
    values: NDArray[np.floating],
    names: Sequence[str],
    structure: str | None,
    times: ArrayLike | None = None,
) -> None:
    """Write values (n, C); columns are maps of .dscalar.nii or frames of .dtseries.nii.

    ``names`` are the C names of maps; frames have no names. ``structure`` is "CortexLeft" or
    "CortexRight". ``times`` (C,) are the times of frames in seconds, evenly spaced, by default 0,
    1, 2, ... Raises ResultError if the hemisphere is unknown, no vertex has a value, or the file
    cannot be written.
    """
    is_series = os.fspath(path).lower().endswith(".dtseries.nii")
    count = values.shape[1]
    rows: object
    if is_series:
        seconds = np.arange(count) if times is None else np.asarray(times, dtype=np.float64)
        rows = _cifti2().SeriesAxis(float(seconds[0]), even_step(path, seconds), count)
    else:
        rows = _cifti2().ScalarAxis(list(names) or [f"map {k}" for k in range(count)])
    _write(path, rows, values.T, structure, "SERIES" if is_series else "SCALARS")


def write_cifti_labels(path: str | os.PathLike[str], labels: Labels, structure: str | None) -> None:
    """Write labels with names and colours as .dlabel.nii; errors as in `write_cifti_values`."""
    named = {int(key): str(key) for key in np.unique(labels.values)} | dict(labels.names)
    table = {key: (name, labels.colors.get(key, _NO_COLOR)) for key, name in named.items()}
    keys = np.asarray(labels.values, dtype=np.float64)
    if np.abs(keys).max(initial=0) > _KEY_MAX:
        raise ResultError(
            f"cannot write {path}: a key of a label is larger than {_KEY_MAX}, the limit of CIFTI"
        )
    _write(path, _cifti2().LabelAxis(["labels"], table), keys[None], structure, "LABELS")


def _cifti2() -> Any:
    return import_module("nibabel.cifti2")  # the import is slow, and types are missing


def _write(
    path: str | os.PathLike[str],
    rows: object,
    values: NDArray[np.floating],
    structure: str | None,
    intent: str,
) -> None:
    if structure not in STRUCTURES.values():
        raise ResultError(
            f"cannot write {path}: the hemisphere is unknown, which CIFTI requires. Use a name of "
            "the file or of the surface that contains it, such as hemi-L_thickness.dscalar.nii"
        )
    used = np.flatnonzero(np.isfinite(values).any(axis=0))
    if len(used) == 0:
        raise ResultError(f"cannot write {path}: no vertex has a value")
    cortex = _cifti2().BrainModelAxis.from_surface(used, values.shape[1], name=structure)
    image = _cifti2().Cifti2Image(values[:, used].astype(np.float32), header=(rows, cortex))
    image.nifti_header.set_intent(f"NIFTI_INTENT_CONNECTIVITY_DENSE_{intent}")
    write_file(path, image.to_bytes())
