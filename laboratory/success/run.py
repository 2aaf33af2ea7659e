"""Many problems by all versions, one after the other, as one report; and reports of parts put
together.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from abfm.errors import ParameterError
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from laboratory.machine import machine
from laboratory.success.meshes import torus
from laboratory.success.problems import Trial, success_problems
from laboratory.success.record import VERSIONS, run_trial
from laboratory.watched import LEVEL


@dataclass(frozen=True)
class Selection:
    """Which problems: `seed` and `count` of `success_problems`, and of ``part = (k, n)`` only every
    n-th, from the k-th, which is 1 for the first.
    """

    seed: int = 0
    count: int = 6
    part: tuple[int, int] = (1, 1)


def run_success(
    meshes: Mapping[str, TriangleMesh],
    tell: Callable[[str], None] = lambda line: None,
    selection: Selection = Selection(),
    versions: Mapping[str, Parameters] = VERSIONS,
    stopped: Callable[[], bool] = lambda: False,
) -> dict[str, Any]:
    """Match all problems by all versions.

    Parameters
    ----------
    meshes : mapping of names to meshes
    tell : callable, optional
        Told in one line what came out of each problem.
    selection : Selection, optional
    versions : mapping of names to parameters
        The first one is what the others are compared with.
    stopped : callable, optional
        Asked again and again whether to end with what was finished.

    Returns
    -------
    dict
        Only numbers, text, lists and dictionaries: ``rows``, with the ``problem`` and a record
        under the name of every version, then ``settings`` and ``machine``. If it was stopped,
        ``interrupted`` is true and rows are those that were finished.
    """
    rows: list[dict[str, Any]] = []
    tell("compiling")
    for parameters in versions.values():
        run_trial(
            _warm_up(), replace(parameters, iterations=4, stage_iterations=1), stopped=stopped
        )
    every = success_problems(meshes, selection.seed, selection.count)
    problems = list(every)[selection.part[0] - 1 :: selection.part[1]]
    for number, problem in enumerate(problems, 1):
        row: dict[str, Any] = {"problem": problem.to_dict()}
        for name, parameters in versions.items():
            if not stopped():
                row[name] = run_trial(problem, parameters, stopped=stopped).to_dict()
        if stopped():
            break
        rows.append(row)
        tell(f"{number}/{len(problems)} {_line(row, versions)}")
    return {
        "rows": rows,
        "interrupted": stopped(),
        "settings": {
            "seed": selection.seed,
            "count": selection.count,
            "meshes": {name: len(mesh.vertices) for name, mesh in meshes.items()},
            "level": LEVEL,
            "versions": {name: parameters.to_dict() for name, parameters in versions.items()},
        },
        "machine": machine(),
    }


def merged(reports: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return one report of several reports of `run_success`: of other parts, or other meshes.

    Raises
    ------
    ParameterError
        If there is none, or they are of different versions or seeds.
    """
    if not reports:
        raise ParameterError("no reports to put together; give at least one")
    first = reports[0]
    for report in reports:
        for key in ("versions", "seed", "level"):
            if report["settings"][key] != first["settings"][key]:
                raise ParameterError(f"reports of different {key} cannot be put together")
    meshes = {
        name: size for report in reports for name, size in report["settings"]["meshes"].items()
    }
    return {
        "rows": [row for report in reports for row in report["rows"]],
        "interrupted": any(report["interrupted"] for report in reports),
        "settings": {**first["settings"], "meshes": meshes},
        "machine": first["machine"],
    }


def _warm_up() -> Trial:
    """Return a problem on a mesh that has a coarser one, so that all that is needed compiles."""
    return Trial(
        "",
        0,
        torus(120, 50),
        "gaussian",
        "gaussian:vertex=0,width=0.2",
        "gaussian:vertex=4,width=0.2",
    )


def _line(row: dict[str, Any], versions: Mapping[str, Parameters]) -> str:
    problem = row["problem"]
    kind = [problem["mesh"], problem["family"]]
    kind += [f"{problem['width']:g}", problem["distance"]] if problem["width"] else []
    results = [
        f"{name} {_number(row[name]['mismatch'])} ({_number(row[name]['verified'])}) "
        f"{row[name]['seconds']:.1f} s"
        for name in versions
    ]
    return f"{', '.join(kind)}: {'; '.join(results)}"


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.2g}"
