"""Figure 9: one field whose flow is a symmetry, the rotation of a shape by 180 degrees."""

from dataclasses import dataclass, replace

from abfm.assets import asset_path
from abfm.experiments import symmetry_flow
from abfm.experiments.experiment import Experiment, Findings, Measure, Report, affordable_iterations
from abfm.experiments.meshes import bundled, two_armed
from abfm.experiments.sheet import Coordinates, Panel, Sheet
from abfm.experiments.symmetry_flow import SymmetrySetup
from abfm.experiments.table_1 import TABLE_1
from abfm.experiments.witnesses import all_measures, notes, of_flow
from abfm.functions.vertex_map_file import read_vertex_map
from abfm.maps.quality import MapQuality
from abfm.maps.symmetry import detect_symmetry
from abfm.mesh import TriangleMesh


@dataclass(frozen=True, eq=False, kw_only=True)
class Figure9(SymmetrySetup):
    """A symmetry, and with the experiment's own mesh a mirror symmetry beside it."""

    mirror: SymmetrySetup | None


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> Figure9:
    """A generated shape with a rotation and a human with a mirror plane, or the symmetry that a given mesh has."""
    shape = mesh or two_armed(3 if small else 4)
    # cooled to the printed sigma: a turn to the left and one to the right fit equally well at first, and without
    # cooling some parts of the shape turn one way and some the other, for good
    p = TABLE_1[9].parameters(cooling_stages=3, iterations=100 if small else affordable_iterations(shape, 250))
    main = symmetry_flow.set_up(shape, "mesh" if mesh else "two arms", symmetry_flow.detected(shape), p)
    mirror = None
    if mesh is None:
        human = bundled("human_A.off")
        p = replace(p, iterations=15 if small else p.iterations)
        mirror = symmetry_flow.set_up(human, "human_A.off", detect_symmetry(human, "mirror"), p)
    return Figure9(**vars(main), mirror=mirror)


def run(setup: Figure9, report: Report) -> Findings:
    """Match all functions, one of them alone, and all without cooling; then the human and its mirror image."""
    mesh, symmetry, p = setup.mesh, setup.symmetry, setup.parameters
    found = symmetry_flow.solve(setup, report, "matching", (0.0, 0.3))
    rows = [symmetry_flow.function_row(found), symmetry_flow.map_row(found, setup.marks)]
    measures = symmetry_flow.measures(found, symmetry)
    maps = of_flow(found, "the map", symmetry_flow.MEASURED)
    if symmetry.kind == "rotation":
        bump = symmetry_flow.bump(mesh, setup.marks[0])
        one = symmetry_flow.solve(setup, report, "one function", (0.35, 0.5), (bump,))
        printed = replace(setup, parameters=replace(p, cooling_stages=1, iterations=min(p.iterations, 150)))
        hot = symmetry_flow.solve(printed, report, "without cooling", (0.5, 0.75))
        energies = [match.energy_history[-1, 0] for match in (hot, found)]
        measures += [
            Measure("mismatch with one Gaussian as the only function", one.mismatch),
            Measure("map error with one Gaussian only, mean", symmetry_flow.mean_error(one, symmetry)),
            Measure("energy without cooling over the energy here", energies[0] / energies[1]),
            Measure("map error without cooling, mean", symmetry_flow.mean_error(hot, symmetry)),
        ]
    if setup.mirror is not None:
        row, more, its_maps = _mirror(setup.mirror, report)
        rows.append(row)
        measures += more
        maps |= its_maps
    setting = f"{symmetry_flow.setting(setup)} Printed parameters, but sigma is cooled to {p.sigma:g} in three stages."
    sheet = Sheet(tuple(rows), seen=symmetry_flow.seen(setup), notes=notes(maps))
    return Findings((*measures, *all_measures(maps)), sheet, setting)


def _mirror(setup: SymmetrySetup, report: Report) -> tuple[tuple[Panel, ...], list[Measure], dict[str, MapQuality]]:
    """The human: its function is matched; as a map the mirror is out of reach, whatever the functions."""
    mesh, symmetry = setup.mesh, setup.symmetry
    found = symmetry_flow.solve(setup, report, "mirror", (0.75, 0.85))
    all_places = symmetry_flow.solve(setup, report, "mirror, as a map", (0.85, 1.0), symmetry_flow.places(mesh))
    other = read_vertex_map(mesh, str(asset_path("human.symperm.txt"))) != symmetry.vertex_map
    row = (
        *symmetry_flow.function_row(found, "mirrored function")[:4],
        Panel(mesh, Coordinates(mesh.vertices[symmetry.vertex_map]), "the mirror as a map", "target"),
        Panel(mesh, Coordinates(all_places.advected), "matched: not reached", "result"),
    )
    measures = [
        Measure("mirror: vertices where the detected map is not the file's", other.sum()),
        Measure("mirror: mismatch of the function", found.mismatch),
        Measure("mirror: map error, mean", symmetry_flow.mean_error(found, symmetry)),
        Measure("mirror: mismatch of the three coordinates", all_places.mismatch),
        Measure("mirror: map error with the three coordinates, mean", symmetry_flow.mean_error(all_places, symmetry)),
    ]
    return row, measures, of_flow(all_places, "mirror, three coordinates, the map")


EXPERIMENT = Experiment(
    9,
    "One field's flow is the continuous symmetry map; at 2 τ some drift is noticeable, yet it is relatively small.",
    set_up,
    run,
)
