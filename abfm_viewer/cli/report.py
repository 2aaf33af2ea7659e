"""`abfm report`: a page about a registration, with its numbers as JSON."""

import argparse
import json
import math
from importlib.metadata import version
from pathlib import Path
from typing import Any

import abfm
from abfm import Correspondence, Match, Registration, TriangleMesh
from abfm.errors import printable
from abfm.maps import Distortion
from abfm.outcome import Facts, WarningTopic
from abfm.registration import report
from abfm.wording import percents
from abfm_viewer import pictures
from abfm_viewer.cli import options
from abfm_viewer.cli.exit_status import print_note
from abfm_viewer.cli.progress import long_steps, share_progress
from abfm_viewer.files import outputs
from abfm_viewer.reports.pages import COVERAGE_MIN, RETURN_EDGES_MAX, report_page

SUMMARY = "write a page about a registration: pictures, distortion, warnings"
DESCRIPTION = f"""\
Write a page (.html) about a registration, to print or send. It has the verdict, pictures of both
surfaces and their functions, the distortion, the steps of the continuation and the parameters.
Results of `abfm match` and `abfm symmetric` and maps of `Correspondence.save` also work.

The page warns of folded faces and of a map that covers less than {100 * COVERAGE_MIN:g}% of A.
It also warns if 5% of the vertices have a round-trip error above {RETURN_EDGES_MAX:g} edge lengths.
The element with id "facts" contains all numbers as JSON.

Examples:
  abfm report reg.npz --out report.html
  abfm report sub-01_reg.npz --out sub-01.html --title "sub-01, left" --up z --json
"""
_WIDTH = 400


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = options.adder(parser)
    add("input", "result of `abfm register`, `abfm symmetric` or `abfm match`", "REG.npz")
    add("--out", "page to write (.html)", "FILE", type=Path, required=True)
    add("--title", "title of the page (default: name of the input)", "TEXT")
    options.add_view(add)
    what = f"width of each picture in pixels (default: {_WIDTH})"
    add("--width", what, "N", type=options.width, default=_WIDTH)
    add("--json", "print the numbers of the page as one JSON object")
    add("--quiet", "do not show progress")


def run(arguments: argparse.Namespace) -> int:
    out, quiet = arguments.out, arguments.quiet
    outputs.check(out, [".html"])
    with long_steps(quiet):
        found = _loaded(arguments.input)
        with share_progress("report", quiet) as update:
            update("measuring", 0.0)
            distortion = found.distortion()
            facts = _facts(arguments, found, distortion)
            drawn = pictures.registration_pictures(
                found, distortion, arguments.width, options.view_of(arguments), update
            )
    for warning in facts["warnings"]:
        print_note(warning, "warning")
    outputs.write_text(out, report_page(facts, drawn))
    if arguments.json:
        print(json.dumps(facts))
    else:
        print(f"{facts['headline']}\nwrote {printable(out)}")
    return 0


def _loaded(path: str) -> Correspondence:
    """Return the map in a file; for a match, its flow as a map of the surface to itself."""
    found: Match | Correspondence = options.load_result(path, Match, Correspondence)
    if isinstance(found, Match):
        return Registration(Correspondence.of_same_faces(found.mesh, found.mesh), found)
    return found


def _facts(
    arguments: argparse.Namespace, found: Correspondence, distortion: Distortion
) -> dict[str, Any]:
    """Return the contents of the report's page as numbers and texts; None if unknown."""
    name = printable(Path(arguments.input).name)
    facts: dict[str, Any] = {
        "abfm": version("abfm"),
        "file": name,
        "title": printable(arguments.title or name),
        "a": _sizes(found.a),
        "b": _sizes(found.b),
        "headline": "a map without functions",
    }
    reported: Facts | None = getattr(found, "facts", None)
    if reported is not None:
        facts |= abfm.loading.task_of(found).report.details(found)
        facts |= {"why": reported.reason, "advice": reported.advice, "tone": reported.tone}
    if "map" not in facts:
        facts["map"] = report.map_details(found, distortion)
    if isinstance(found, Registration):
        facts |= _of_registration(found)
        if found.a is found.b:  # the initial map is the identity
            for name in report.initial_details(found.initial):
                del facts[name]
    warnings = _warnings(facts["map"], reported)
    facts["warnings"] = [*(reported.warnings if reported else []), *warnings.values()]
    facts["topics"] = [*(reported.topics if reported else []), *warnings]
    return dict(_finite(facts))


def _of_registration(found: Registration) -> dict[str, Any]:
    """Return the facts of a registration that are not facts of its map or its verdict."""
    match = found.match
    facts: dict[str, Any] = {
        "notes": [*found.notes, *match.mesh.messages],
        "changed_parameters": match.parameters.changed(),
        "functions": list(zip(*match.problem.specs, strict=True)),
    }
    if found.a is not found.b:
        facts["initial_map"] = report.map_details(found.initial)
    if (errors := match.landmark_errors) is not None:
        facts["landmarks"] = {
            "errors": errors.tolist(),
            "farthest": float(errors.max()),
            "alone": match.problem.is_of_landmarks,
        }
    return facts


def _sizes(mesh: TriangleMesh) -> dict[str, int]:
    return {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}


def _warnings(of_map: dict[str, Any], reported: Facts | None) -> dict[WarningTopic, str]:
    """Return warnings about a map, by topic, in addition to those that its facts report.

    ``of_map`` are measurements of the map. ``reported`` is None for a map without a match.
    """
    folded, collapsed, faces = (of_map[name] for name in ("folded", "collapsed", "faces"))
    round_trip, covered = of_map["round_trip"]["p95"], of_map["coverage"]
    texts = {}
    if folded and reported is None:
        part = percents(folded / faces, ".3g")
        texts[WarningTopic.FOLDED_FACES] = f"{folded:,} of {faces:,} faces are folded, {part}"
    if collapsed:
        texts[WarningTopic.COLLAPSED_FACES] = (
            f"{collapsed:,} of {faces:,} faces collapse to a line or a point"
        )
    if covered < COVERAGE_MIN:
        texts[WarningTopic.LOW_COVERAGE] = f"only {percents(covered, '.3g')} of A is covered"
    if round_trip > RETURN_EDGES_MAX:
        texts[WarningTopic.ROUND_TRIP_ERROR] = (
            f"5% of the vertices have a round-trip error of {round_trip:.2g} edges or more"
        )
    return texts


def _finite(value: Any) -> Any:
    """Return facts with None in place of NaN and infinite numbers, which JSON cannot represent."""
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
