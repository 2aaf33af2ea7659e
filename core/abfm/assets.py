"""Meshes that are installed with the package (sources and licences: ``assets/README.md``)."""

from pathlib import Path

from abfm.errors import MeshError, did_you_mean


def asset_names() -> list[str]:
    """Return the file names of the installed meshes and vertex permutations, sorted."""
    folder = _folder()
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted(file.name for file in files if file.suffix != ".md")


def asset_path(name: str) -> Path:
    """Return the path of an installed file such as ``human_A.off``; MeshError if it is missing."""
    names = asset_names()
    if name not in names:
        known = ", ".join(names) or "none"
        raise MeshError(
            f"there is no bundled file {name}{did_you_mean(name, names)}; available: {known}"
        )
    return _folder() / name


def _folder() -> Path:
    """Return the folder of the meshes: in the package, or in the repository (editable install)."""
    here = Path(__file__).resolve().parent
    return here / "assets" if (here / "assets").is_dir() else here.parents[1] / "assets"
