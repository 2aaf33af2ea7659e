"""The meshes that are shipped with the package (sources and licences: ``assets/README.md``)."""

from pathlib import Path

from abfm.errors import MeshError, did_you_mean


def asset_names() -> list[str]:
    """Return the file names of the shipped meshes and vertex permutations, sorted."""
    folder = _folder()
    return (
        sorted(file.name for file in folder.iterdir() if file.suffix != ".md")
        if folder.is_dir()
        else []
    )


def asset_path(name: str) -> Path:
    """Return the path of a shipped file, for example ``asset_path("human_A.off")``.

    Raises
    ------
    MeshError
        If there is no such file; suggests the nearest name.
    """
    names = asset_names()
    if name not in names:
        known = ", ".join(names) or "none"
        raise MeshError(
            f"no mesh called {name} is shipped{did_you_mean(name, names)}: known are {known}"
        )
    return _folder() / name


def _folder() -> Path:
    """Return the data of a wheel, or the repository's in an editable install."""
    here = Path(__file__).resolve().parent
    return here / "assets" if (here / "assets").is_dir() else here.parents[1] / "assets"
