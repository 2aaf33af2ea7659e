"""Populations generated from a template by known flows, on a small sphere.

Rows are solved in this process. Tests of batches cover other workers.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import abfm
from abfm import AbfmError, Flow, ParameterError, Population, TriangleMesh, load
from abfm.batch import Ledger, LedgerEntry, Workers
from abfm.batch.attempt import WorkItem, attempt
from abfm.batch.run import with_contents
from abfm.calculus.operators import vertex_areas
from abfm.functions import quoted
from abfm.io import write_surface
from abfm.mesh.shapes import even_sphere
from abfm.population import Channel, Cohort, Settings, Subject
from abfm.population.solver import PopulationSolver
from abfm.population.subject_transfer import SubjectTransfer
from abfm.population.target import Target
from abfm.workers.control import CancelledError, Control
from tests.messages import check_message, raises
from tests.shapes import icosphere

MESH = icosphere(3)
BRIEF = {"refine": 0, "iterations": 30}
SHORT = Settings(options=BRIEF, rounds=2)


def height(places):
    """Return a function that every rotation changes."""
    x, y, z = np.asarray(places).T
    return x + y * z + x * z + 0.7 * (z * z - x * x) * y


def label(places):
    return np.tanh(4 * (np.asarray(places)[:, 2] - 0.3))


def field(number):
    """Return one of two smooth fields of about 0.07 sqrt(area)."""
    x, y, z = np.moveaxis(MESH.vertices[MESH.faces].mean(axis=1), -1, 0)
    axes = [(0.3 * y, 0.2 + 0 * x, 0.25 * x), (0.2 * z, 0.3 * x, -0.2 + 0 * x)]
    return np.cross(np.stack([x, y, z], axis=1), np.stack(axes[number], axis=1))


@pytest.fixture(scope="module", autouse=True)
def names():
    """Solve rows and transfers in this process; yield the names of those that were solved."""
    names = []

    def compute(self, computations, control):
        for each in computations:
            if control.cancelled:
                return
            names.append(f"{each.subject.name}, transferred")
            yield attempt(WorkItem(each, contents={}))

    def run(self, rows, folder, *, on_change, control):
        ledger = Ledger(folder)
        identity = ledger.make()
        for row in rows:
            if ledger.entry(row).state != "done" and not control.cancelled:
                names.append(row.name)
                record = attempt(WorkItem(row, str(ledger.folder), identity, {})).record
                on_change(ledger.record(row, record))
        return ledger.entries(rows)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Workers, "run", run)
        patch.setattr(Workers, "compute", compute)
        yield names


@pytest.fixture
def solved(names):
    names.clear()
    return names


def registered(names):
    """Return the names of rows that were registered, without transfers."""
    return [name for name in names if not name.endswith(", transferred")]


class Place:
    """A folder with a template and the files of subjects."""

    def __init__(self, folder, mesh=MESH):
        self.folder, self.template, self.subjects = folder, folder / "template.ply", []
        folder.mkdir(exist_ok=True)
        write_surface(self.template, mesh)

    def file(self, name, values):
        np.save(self.folder / f"{name}.npy", values)
        return f"file:{quoted(str(self.folder / name))}.npy"

    def add(self, name, *values, **more):
        texts = (self.file(f"{name} {c}", each) for c, each in enumerate(values))
        self.subjects.append(Subject(name, tuple(texts), **more))
        return self

    def add_equal(self, names, *values):
        for name in names:
            self.add(name, *values)
        return self

    def add_moved(self, *names):
        for name in names:
            self.add(name, pushed(FIELDS[name], height))
        return self

    def registered(self, settings=SHORT, held_out=(), order=None, **more):
        channels = Channel("height"), *(Channel(name, is_held_out=True) for name in held_out)
        subjects = self.subjects if order is None else [self.subjects[i] for i in order]
        cohort = Cohort(channels, tuple(subjects))
        return abfm.register_population(
            cohort, self.template, self.folder / "out", settings, **more
        )


def pushed(velocity, f, noise=0.0, seed=0):
    values = Flow(MESH, velocity).point_map().pull_back(f(MESH.vertices))
    return values + noise * np.random.default_rng(seed).normal(size=len(values))


FIELDS = {
    "plus": field(0),
    "minus": -field(0),
    "over": 0.6 * field(1),
    "under": -0.6 * field(1),
    "still": 0 * field(0),
}


def five(folder):
    place = Place(folder)
    for seed, (name, velocity) in enumerate(FIELDS.items()):
        place.add(name, pushed(velocity, height, 0.02, seed), pushed(velocity, label))
    return place


def with_outlier(folder):
    noise = np.random.default_rng(9).normal(size=(3, len(MESH.vertices)))
    return five(folder).add("outlier", (MESH.vertices**3 * noise.T).sum(axis=1), noise[0])


@pytest.fixture(scope="module")
def population_folder(tmp_path_factory):
    """Return a folder whose population is registered once, for tests that resume it."""
    return with_outlier(tmp_path_factory.mktemp("population"))


@pytest.fixture(scope="module")
def population(population_folder):
    return population_folder.registered(held_out=["label"])


def error(mean, f=height):
    truth, areas = f(MESH.vertices), vertex_areas(MESH)
    return np.sqrt(np.average((mean - truth) ** 2, weights=areas) / np.var(truth))


def test_equal_subjects_equal_their_mean(tmp_path):
    found = Place(tmp_path).add_equal("abc", height(MESH.vertices)).registered()
    assert found.mean() == pytest.approx(height(MESH.vertices), abs=1e-9)
    assert found.deviation() == pytest.approx(0, abs=1e-7)
    assert found.log2_area_deviation == pytest.approx(0, abs=1e-7)
    assert found.changes.tolist() == pytest.approx([0], abs=1e-9)
    assert found.phase_and_amplitude().total == 0
    assert found.correlation == pytest.approx(1)


def test_template_object_preserves_vertex_numbers(tmp_path):
    """Functions and vertex numbers count unused vertices of the template, which come first."""
    place, settings = Place(tmp_path).add_moved("plus", "minus"), Settings(options=BRIEF, rounds=1)
    of_file = place.registered(settings)

    unused = np.full((2, 3), 0.1)
    place.subjects.clear()
    for name in ("plus", "minus"):
        place.add(name, np.append([9.0, 9.0], pushed(FIELDS[name], height)))
    given = np.vstack([unused, MESH.vertices]), MESH.faces + 2
    for template in (given, TriangleMesh(*given, structure="CortexLeft")):
        place.template = template
        found = place.registered(settings)
        assert found.template.vertices.tolist() == MESH.vertices.tolist()
        assert found.template.vertex_ids[0] == 2
        assert found.values.tolist() == of_file.values.tolist()
    assert found.template.structure == "CortexLeft"

    place.template = given[0]
    with raises(AbfmError, "template", "file name"):
        place.registered(settings)


def test_opposite_flows_have_the_template_as_mean(tmp_path):
    found = Place(tmp_path).add_moved("plus", "minus").registered()
    assert error(found.before[0, :, 0]) > 0.35  # the error of the initial map
    assert error(found.mean()) < 0.6 * error(found.plain_mean()) < 0.1
    phase = found.phase_and_amplitude()
    assert phase.phase > 0.95 * phase.total
    assert phase.phase + phase.amplitude == pytest.approx(phase.total)


def test_template_does_not_drift_to_first_target(tmp_path):
    """The mean is at the center of the subjects, although the first target has all on one side."""
    place = Place(tmp_path)
    for name in ("plus", "minus", "still"):
        place.add(name, pushed(FIELDS[name] + field(1), height))
    middle = pushed(field(1), height)
    own = place.file("own", height(MESH.vertices))
    found = place.registered(Settings({"height": own}, options=BRIEF, rounds=2))

    def deviation(values):
        return np.sqrt(np.mean((values - middle) ** 2) / np.var(middle))

    assert deviation(height(MESH.vertices)) > 0.2
    assert deviation(found.mean()) < 0.05
    # the drift is small, because the last target is at the center
    assert (
        np.linalg.norm(found.drift, axis=1).mean() < 0.1 * np.linalg.norm(field(1), axis=1).mean()
    )


def test_outlier_is_named_and_excluded(population):
    assert population.fits.tolist() == [True] * 5 + [False]
    assert population.names[5] == "outlier"
    assert population.reasons[5]
    assert not any(population.reasons[:5])
    assert population.worst_first()[0] == 5
    expected = population.values[:5, :, 0].mean(axis=0)
    assert population.mean() == pytest.approx(expected)
    assert population.deviation() == pytest.approx(population.values[:5, :, 0].std(axis=0, ddof=1))
    assert population.mean_of_others(5) == pytest.approx(expected)
    assert population.mean_of_others(0) == pytest.approx(population.values[1:5, :, 0].mean(axis=0))


def test_repeated_outlier_stays_excluded(tmp_path, monkeypatch):
    """A subject that is excluded in every second round (by a patch) stays excluded."""
    evaluate, excluded_by_round = PopulationSolver._evaluate, {}

    def strict(self, entries, fits, failures, number, stays_excluded):
        found = evaluate(self, entries, fits, failures, number, stays_excluded)
        names = np.array([subject.name for subject in self.cohort.subjects])
        excluded_by_round[number] = names[stays_excluded].tolist()
        if number % 2 == 0:
            return found
        fits = found.outliers.fits & (names != "over")
        return found._replace(outliers=replace(found.outliers, fits=fits))

    monkeypatch.setattr(PopulationSolver, "_evaluate", strict)
    settings = Settings(options=BRIEF | {"iterations": 2}, rounds=4, bound=0)
    found = five(tmp_path).registered(settings, held_out=["label"])
    assert excluded_by_round == {1: [], 2: [], 3: [], 4: ["over"]}
    assert [name for name, fits in zip(found.names, found.fits, strict=True) if not fits] == [
        "over"
    ]
    check_message(found.reasons[found.subject("over")])


def test_mean_is_closer_than_plain_mean(population):
    assert error(population.mean()) < 0.7 * error(population.plain_mean())
    assert error(population.mean("label"), label) < error(population.plain_mean("label"), label)


def test_alignment_improves_a_held_out_channel(population):
    before, after = population.scores("label")[:5].T
    assert (after[:4] > before[:4]).all()
    assert population.scores("label") == pytest.approx(population.scores(1))
    assert population.scores()[:5, 1] == pytest.approx(population.correlation[:5])


def test_fields_recover_generating_flows(population, population_folder):
    """Median errors are below 70% of the motion, whose part along contours is undetermined."""
    for i, name in enumerate(population.names[:4]):
        drift = Flow(MESH, -population.drift).point_map()
        found = abfm.load(population_folder.folder / "out" / f"{population.digests[i]}.npz")
        places = drift.followed_by(found.points).positions
        truth = Flow(MESH, FIELDS[name]).point_map(inverse=True).positions
        off, moved = (
            np.median(np.linalg.norm(each - truth, axis=1)) for each in (places, MESH.vertices)
        )
        assert off < 0.7 * moved


def test_repeated_run_solves_only_missing_rows(population_folder, population, solved):
    again = population_folder.registered(held_out=["label"])
    assert registered(solved) == []
    result = population_folder.folder / "out" / f"{population.digests[2]}.npz"
    content = result.read_bytes()
    result.unlink()
    third = population_folder.registered(held_out=["label"])
    assert registered(solved) == ["over"]
    assert result.read_bytes() == content
    assert not list((population_folder.folder / "out" / "targets").glob("tmp*"))
    for other in (again, third):
        other.save(population_folder.folder / "other.npz")
        population.save(population_folder.folder / "usual.npz")
        one, two = (
            (population_folder.folder / f"{name}.npz").read_bytes() for name in ("usual", "other")
        )
        assert one == two


@pytest.mark.parametrize("at_edges", [False, True])
def test_sent_files_give_the_same_transfer(population_folder, population, at_edges):
    out, first = population_folder.folder / "out", population_folder.subjects[0]
    mask, drift = "expression:1 + 0.5*x", next((out / "targets").glob("round-2-drift-*.npy"))
    one = SubjectTransfer(
        replace(first, functions=(first.functions[0], ""), mask=mask),
        str(population_folder.template),
        registration=str(out / f"{population.digests[0]}.npz"),
        drift=str(drift),
        at_edges=at_edges,
    )
    task = WorkItem(one)
    here, with_files = attempt(task).value, with_contents(task)
    assert len(with_files.contents) == 4
    moved = [path.rename(path.with_suffix(".moved")) for path in map(Path, with_files.contents)]
    try:
        assert attempt(task).needs_contents
        sent = attempt(with_files).value
    finally:
        for path, name in zip(moved, with_files.contents, strict=True):
            path.rename(name)
    for ends in ("before", "after"):
        found, other = getattr(here, ends), getattr(sent, ends)
        assert np.array_equal(found.values, other.values, equal_nan=True)
        assert np.array_equal(found.mask, other.mask)
    assert len(here.before.mask) == len(MESH.edges if at_edges else MESH.vertices)
    assert np.isnan(here.after.values).all(axis=0).tolist() == [False, True]
    assert here.after.mask.min() < 0.9 < 1.1 < here.after.mask.max()


def test_order_of_subjects_changes_no_result(population_folder, population, solved):
    order = [3, 5, 0, 4, 1, 2]
    other = population_folder.registered(held_out=["label"], order=order)
    assert registered(solved) == []
    assert other.names == tuple(population.names[i] for i in order)
    for name in ("values", "before", "masks", "fits", "numbers", "weights"):
        one, two = getattr(population, name), getattr(other, name)
        assert np.array_equal(one[order], two, equal_nan=name not in ("fits",))
    assert np.array_equal(population.mean(), other.mean()) or population.mean() == pytest.approx(
        other.mean(), abs=1e-14
    )
    assert np.array_equal(population.drift, other.drift)


def test_saved_population_is_loaded_equal(population, tmp_path):
    path = tmp_path / "p.npz"
    population.save(path)
    found = load(path)
    for name, value in vars(population).items():
        if isinstance(value, np.ndarray):
            assert np.array_equal(getattr(found, name), value, equal_nan=value.dtype.kind == "f")
        elif name != "template":
            assert getattr(found, name) == value
    assert np.array_equal(found.template.faces, MESH.faces)
    assert found.phase_and_amplitude() == population.phase_and_amplitude()
    values = found.values.copy()
    with np.load(path) as file:
        np.savez_compressed(tmp_path / "packed.npz", **file)
    assert np.array_equal(load(tmp_path / "packed.npz").values, values, equal_nan=True)
    # the loaded values may be mapped from the file that is overwritten
    replace(population, values=2 * values).save(path)
    assert np.array_equal(found.values, values, equal_nan=True)


def test_population_is_immutable(population):
    with pytest.raises(ValueError, match="read-only"):
        population.values[0, 0, 0] = 1
    with pytest.raises(AttributeError):
        population.fits = None


def test_damaged_files_are_refused(population, tmp_path):
    path = tmp_path / "p.npz"
    population.save(path)
    content = path.read_bytes()
    place = content.index(population.values[2].tobytes())
    changed = content[: place + 9] + bytes([content[place + 9] ^ 1]) + content[place + 10 :]
    for damaged in (content[:10], content[:2000], content[:-300], changed):
        path.write_bytes(damaged)
        with raises(AbfmError, "p.npz", recorded=False):
            load(path, Population)


def test_unknown_names_are_refused(population):
    with raises(ParameterError, "pluss", "plus"):
        population.subject("pluss")
    assert population.subject("minus") == 1
    for channel in ("depth", 2, -1):
        with raises(ParameterError):
            population.mean(channel)


def test_rotated_surface_has_the_same_population(tmp_path):
    turn = Rotation.from_rotvec([0.4, -1.1, 0.3]).as_matrix()
    turned = TriangleMesh(3 * MESH.vertices @ turn.T, MESH.faces)
    found = []
    for name, mesh in (("one", MESH), ("other", turned)):
        place = Place(tmp_path / name, mesh).add_moved("plus", "minus")
        found.append(place.registered(Settings(options=BRIEF, rounds=1)))
    one, other = found
    assert one.mean() == pytest.approx(other.mean(), abs=0.01)
    assert one.phase_and_amplitude() == pytest.approx(other.phase_and_amplitude(), rel=0.05)
    assert one.log2_area == pytest.approx(other.log2_area, rel=0.05)


def test_subject_weights_change_the_mean(tmp_path):
    place = Place(tmp_path)
    for name, weight in (("plus", 3.0), ("minus", 1.0), ("still", 0.0)):
        place.add(name, pushed(FIELDS[name], height), weight=weight)
    found = place.registered(Settings(options=BRIEF, rounds=1))
    expected = (3 * found.values[0, :, 0] + found.values[1, :, 0]) / 4
    assert found.mean() == pytest.approx(expected)
    assert found.fits.all()
    assert np.isfinite(found.correlation).all()  # the subject of weight 0 also has a map
    # closer to the subject with the larger weight: 3/4 of plus, 1/4 of minus
    middle = pushed(0.5 * FIELDS["plus"], height)
    assert np.mean((found.mean() - middle) ** 2) < np.mean(
        (found.mean() - height(MESH.vertices)) ** 2
    )


def test_unknown_values_of_a_subject_are_ignored(tmp_path):
    place, hidden = Place(tmp_path), MESH.vertices[:, 0] > 0.6
    for name in ("a", "b", "c", "d"):
        values = {"height": height(MESH.vertices), "label": label(MESH.vertices)}
        if name != "b":
            channel = "label" if name == "d" else "height"
            values[channel] = np.where(hidden, np.nan, values[channel])
        place.add(name, *values.values())
    found = place.registered(Settings(options=BRIEF, rounds=1), held_out=["label"])
    assert found.fits.all()
    inside, outside = MESH.vertices[:, 0] > 0.8, MESH.vertices[:, 0] < 0.4
    assert (found.masks[[0, 2, 3]] == 0)[:, inside].all()
    assert found.masks[:, outside] == pytest.approx(1)
    assert found.mean() == pytest.approx(height(MESH.vertices), abs=0.02)
    assert found.mean("label") == pytest.approx(label(MESH.vertices), abs=0.05)
    assert np.isfinite(found.scores("label")).all()


def test_unknown_values_of_the_template_are_ignored(tmp_path):
    place, hidden = Place(tmp_path), MESH.vertices[:, 0] > 0.6
    own = place.file("own", np.where(hidden, np.nan, height(MESH.vertices)))
    place.add_equal("ab", height(MESH.vertices))
    found = place.registered(Settings({"height": own}, options=BRIEF, rounds=1))
    assert found.fits.all()
    assert found.mean() == pytest.approx(height(MESH.vertices), abs=0.02)


def test_disjoint_channels_exclude_a_subject(tmp_path):
    place, upper = Place(tmp_path), MESH.vertices[:, 2] > 0
    place.add_equal("abc", height(MESH.vertices), label(MESH.vertices))
    halves = [np.where(half, height(MESH.vertices), np.nan) for half in (upper, ~upper)]
    place.add("d", *halves)
    found = place.registered(Settings(options=BRIEF, rounds=1), held_out=["label"])
    assert found.fits.tolist() == [True, True, True, False]
    check_message(found.reasons[3])


def test_masked_template_vertices_are_ignored(tmp_path):
    place, hidden = Place(tmp_path), MESH.vertices[:, 0] > 0.6
    mask = place.file("mask", np.where(hidden, 0.0, 1.0))
    for seed, name in enumerate(("a", "b", "c")):
        junk = np.random.default_rng(seed).normal(size=len(MESH.vertices))
        place.add(name, np.where(hidden, 10 * junk, height(MESH.vertices)))
    found = place.registered(Settings(mask=mask, options=BRIEF, rounds=1))
    assert (found.areas[hidden] == 0).all()
    assert found.correlation == pytest.approx(1, abs=0.01)


def test_other_surfaces_use_initial_maps(tmp_path):
    place, other = Place(tmp_path), even_sphere(250)
    surface = tmp_path / "other.ply"
    write_surface(surface, other)
    place.add("own", height(MESH.vertices))
    for name in ("finer", "again"):
        directions = other.vertices / np.linalg.norm(other.vertices, axis=1)[:, None]
        place.add(name, height(directions), surface=str(surface))
    found = place.registered(Settings(initial="closest", options=BRIEF, rounds=1))
    assert found.fits.all()
    assert error(found.plain_mean()) < 0.05
    assert error(found.mean()) < 0.08


@pytest.mark.parametrize(("word", "needs"), [("embedding", "functions"), ("landmarks", "landm")])
def test_initial_map_without_functions_is_refused(tmp_path, word, needs):
    place = Place(tmp_path).add_equal("ab", height(MESH.vertices))
    with raises(ParameterError, word, "--channel"):
        place.registered(Settings(initial=word))


@pytest.mark.parametrize("word", ["embedding", "landmarks"])
def test_landmarks_replace_functions_of_the_template(tmp_path, word):
    """Only landmarks determine the initial map of rotated surfaces, without functions."""
    place, other = Place(tmp_path, icosphere(2)), even_sphere(120)
    turn = Rotation.from_rotvec([0.5, -0.8, 0.3]).as_matrix()
    surface, marks = tmp_path / "other.ply", tmp_path / "marks.csv"
    write_surface(surface, TriangleMesh(other.vertices @ turn.T, other.faces))
    # landmarks on the turned sphere and on the template
    points = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-0.6, 0, 0.8]])
    np.savetxt(marks, np.column_stack([points @ turn.T, points]), delimiter=",")
    for name in ("one", "other"):
        values = height(other.vertices)
        place.add(name, values, surface=str(surface), landmarks=str(marks))
    found = place.registered(Settings(initial=word, options=BRIEF, rounds=1))
    truth = height(icosphere(2).vertices)
    assert np.std(found.plain_mean() - truth) < 0.15 * np.std(truth)
    assert found.correlation == pytest.approx(1, abs=0.01)
    assert (found.landmarks < 0.05).all()


def test_landmarks_determine_rotation(tmp_path, solved):
    """Landmarks fix the rotation about the vertical, under which heights are invariant."""
    place, axis = Place(tmp_path), np.array([0.0, 0.0, 1.0])
    turn = Rotation.from_rotvec(0.25 * axis).as_matrix()
    near = np.argsort(np.abs(MESH.vertices[:, 2]), kind="stable")[:60:6]
    marks = tmp_path / "marks.csv"

    def mark(points):
        np.savetxt(marks, np.column_stack([points, MESH.vertices[near]]), delimiter=",")

    mark(MESH.vertices[near] @ turn.T)
    for name in "ab":
        place.add(name, MESH.vertices[:, 2], landmarks=str(marks) if name == "b" else "")
    own = Settings({"height": "coordinate:z"}, options=BRIEF, rounds=1)
    found = place.registered(own)
    assert np.isnan(found.landmarks).tolist() == [True, False]
    assert found.landmarks[1] < 0.01
    assert found.displacement[1] > 0.02
    # a file of the same name with other content is registered again
    solved.clear()
    mark(MESH.vertices[near])
    other = place.registered(own)
    assert registered(solved) == ["b"]
    assert other.displacement[1] < 0.1 * found.displacement[1]


def test_spectral_initial_maps_need_no_functions(tmp_path):
    """On bodies that are not spheres, the initial map is unique without functions."""
    ball = even_sphere(80)
    x, y, z = ball.vertices.T
    sizes = np.stack([1 + 0.3 * z, 1.4 + 0.2 * x, 2 + 0 * y], axis=1)
    place = Place(tmp_path, TriangleMesh(ball.vertices * sizes, ball.faces))
    place.add_equal("ab", height(ball.vertices))
    found = place.registered(Settings(initial="spectral", options=BRIEF, rounds=1))
    assert np.std(found.mean() - height(ball.vertices)) < 0.1 * np.std(height(ball.vertices))


def test_channel_of_larger_weight_is_aligned(tmp_path):
    place, still = Place(tmp_path), pushed(FIELDS["still"], height)
    for name in ("plus", "minus"):
        place.add(name, pushed(FIELDS[name], height), pushed(-FIELDS[name], label))
    place.add("still", still, label(MESH.vertices))
    channels = Channel("height"), Channel("label")
    cohort = Cohort(channels, tuple(place.subjects))
    own = {"height": place.file("h", still), "label": place.file("l", label(MESH.vertices))}

    def registered(**weights):
        settings = Settings(own, options=BRIEF, rounds=1, weights=weights)
        return abfm.register_population(cohort, place.template, place.folder / "out", settings)

    first, second = registered(label=1e-3), registered(height=1e-3)
    errors = [[error(found.values[0, :, 0]) for found in (first, second)]]
    errors += [[error(found.values[0, :, 1], label) for found in (second, first)]]
    for follows, does_not in errors:
        assert follows < 0.5 * does_not
    assert first.channel_weights.tolist() == [1, 1e-3]
    # the similarity uses the same weights
    scores = np.stack([first.scores(c)[:, 1] for c in range(2)])
    assert first.correlation == pytest.approx(np.average(scores, axis=0, weights=[1, 1e-3]))
    rows = Ledger(place.folder / "out").read_rows()[1]
    assert [each[0] for each in rows[0].row.options].count("channel") == 2


def test_channel_weight_1_changes_no_row(tmp_path, solved):
    place = Place(tmp_path).add_equal("ab", height(MESH.vertices))
    place.registered(Settings(options=BRIEF, rounds=1))
    solved.clear()
    place.registered(Settings(options=BRIEF, rounds=1, weights={"height": 1.0}))
    assert registered(solved) == []


def test_failed_transfer_excludes_a_subject(tmp_path):
    place, gone = Place(tmp_path), f"file:{tmp_path}/gone.npy"
    place.add_equal("abc", height(MESH.vertices), label(MESH.vertices))
    place.subjects[1] = Subject("b", (place.subjects[1].functions[0], gone))
    found = place.registered(held_out=["label"])
    assert found.fits.tolist() == [True, False, True]
    check_message(found.reasons[1])
    assert "gone.npy" in found.reasons[1]
    assert found.digests[1] == ""


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"functions": {"depth": "coordinate:x"}}, "depth"),
        ({"functions": {"height": ""}}, "height"),
        ({"weights": {"label": 2.0}}, "label"),
        ({"weights": {"heigth": 2.0}}, "height"),
    ],
)
def test_settings_of_unknown_channels_are_refused(tmp_path, settings, named):
    place = Place(tmp_path).add_equal("ab", height(MESH.vertices), label(MESH.vertices))
    with raises(ParameterError, named):
        place.registered(Settings(**settings), held_out=["label"])


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"rounds": 0}, ("rounds", 0, 1, 1000)),
        ({"rounds": 1.5}, ("rounds", "1.5")),
        ({"bound": -1.0}, ("bound", "-1.0")),
        ({"bound": float("nan")}, ("bound", "nan")),
        ({"weights": {"height": 0.0}}, ("height", "0.0", 0)),
        ({"weights": {"height": float("nan")}}, ("height", "nan")),
        ({"weights": {"height": "2"}}, (2, "height")),
    ],
)
def test_invalid_settings_are_refused(settings, named):
    with raises(ParameterError, *named):
        Settings(**settings)


def test_failed_registration_excludes_a_subject(tmp_path):
    place = Place(tmp_path).add_equal("abc", height(MESH.vertices))
    place.subjects.append(Subject("gone", (f"file:{tmp_path}/gone.npy",)))
    changed = []
    found = place.registered(on_change=changed.append)
    assert found.fits.tolist() == [True, True, True, False]
    check_message(found.reasons[3])
    assert "gone.npy" in found.reasons[3]
    assert found.digests[3] == ""
    assert np.isnan(found.values[3]).all()
    assert all(isinstance(entry, LedgerEntry) for entry in changed)
    assert [entry.row.name for entry in changed if entry.reason] == ["gone"]


def test_one_registered_subject_is_refused(tmp_path):
    place = Place(tmp_path).add("a", height(MESH.vertices))
    place.subjects.append(Subject("gone", (f"file:{tmp_path}/gone.npy",)))
    with raises(AbfmError, 1, 2):
        place.registered(Settings({"height": "coordinate:x"}, options=BRIEF))


def test_cancelled_run_resumes(tmp_path, solved):
    place, control = Place(tmp_path).add_moved("plus", "minus", "still"), Control()
    with pytest.raises(CancelledError):
        place.registered(on_change=lambda entry: control.cancel(), control=control)
    assert len(solved) == 4  # three transfers for the first target, and one registration
    found = place.registered(Settings(options=BRIEF, rounds=1))
    assert sorted(registered(solved)) == ["minus", "plus", "still"]
    assert found.fits.all()


def test_noise_is_amplitude_and_not_phase(tmp_path):
    """Independent noise is amplitude: interpolation at vertices does not make half of it phase."""
    place, noise = Place(tmp_path), 0.3
    moved = ["plus", "minus", "plus", "minus"]
    for seed, name in enumerate(moved):
        place.add(f"{seed}", pushed(FIELDS[name], height, noise, seed))
    own = place.file("own", height(MESH.vertices))
    found = place.registered(Settings({"height": own}, options=BRIEF, rounds=1))
    phase = found.phase_and_amplitude()
    clean = np.stack([pushed(FIELDS[name], height) for name in moved])
    position = np.average(clean.var(axis=0), weights=vertex_areas(MESH))
    of_noise = 0.75 * noise**2  # with the factor (n - 1) / n for four subjects
    assert phase.total == pytest.approx(position + of_noise / 2, rel=0.1)
    # the registration does not remove all of it
    assert 0.7 * position < phase.phase < 1.1 * position


def test_goal_is_at_least_the_noise(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "template.ply"
    write_surface(path, MESH)
    smooth, texts = height(MESH.vertices), {}
    for level in (0.0, 0.2):
        noisy = smooth + level * smooth.std() * rng.standard_normal((4, len(smooth)))
        for number, values in enumerate(noisy):
            np.save(tmp_path / f"{number}-{level}.npy", values)
        texts[level] = [f"file:{quoted(str(tmp_path / f'{n}-{level}.npy'))}" for n in range(4)]

    def options(level, settings):
        subjects = tuple(Subject(str(n), (text,)) for n, text in enumerate(texts[level]))
        cohort = Cohort((Channel("height"),), subjects)
        solver = PopulationSolver(cohort, path, tmp_path / "out", settings, Workers())
        target = Target(smooth[None], np.ones(len(smooth)))
        return dict(solver.rows(target, 1)[0].options)

    assert "goal" not in options(0.0, Settings())
    values = np.load(tmp_path / "0-0.2.npy")
    values[MESH.vertices[:, 0] > 0.8] = np.nan
    np.save(tmp_path / "0-0.2.npy", values)
    assert float(options(0.2, Settings())["goal"]) == pytest.approx(0.2, rel=0.3)
    assert options(0.2, Settings(options={"goal": 0.07}))["goal"] == "0.07"


@pytest.mark.filterwarnings("error")
def test_goal_of_pure_noise_is_at_most_1(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "template.ply"
    write_surface(path, MESH)
    noisy = rng.standard_normal((2, len(MESH.vertices)))
    for number, values in enumerate((*noisy, np.ones(len(MESH.vertices)))):
        np.save(tmp_path / f"{number}.npy", values)
    texts = [f"file:{quoted(str(tmp_path / f'{number}.npy'))}" for number in range(3)]

    def goal(*texts):
        subjects = tuple(Subject(str(n), (text,)) for n, text in enumerate(texts))
        cohort = Cohort((Channel("height"),), subjects)
        return PopulationSolver(cohort, path, tmp_path / "out", SHORT, Workers()).goal

    assert 0.9 < goal(*texts) <= 1
    assert goal(texts[2], texts[2]) == abfm.Parameters.goal


def test_masked_values_change_no_bit(tmp_path):
    hidden = MESH.vertices[:, 0] < -0.4

    def registered(name, junk):
        place = Place(tmp_path / name)
        mask = place.file("mask", np.where(hidden, 0.0, 1.0))
        for number, each in enumerate(("plus", "minus")):
            values = pushed(FIELDS[each], height, 0.02, number)
            place.add(each, np.where(hidden, junk, values) if junk else values, mask=mask)
        return place.registered(replace(SHORT, rounds=1))

    clean, other = registered("clean", 0), registered("junk", 1e3)
    for name in ("values", "masks", "residual"):
        assert np.array_equal(getattr(clean, name), getattr(other, name))
    assert clean.verdicts == other.verdicts
