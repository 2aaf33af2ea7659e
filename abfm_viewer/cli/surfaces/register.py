"""`abfm register`: two surfaces, and what leads from the one to the other."""

import argparse
import sys
from pathlib import Path

from abfm import Parameters
from abfm.matching import RESIDUAL_REGISTERED, SHARE_REGISTERED
from abfm.parameters import as_option
from abfm.registration import MEASURED, prepare
from abfm.registration.initial import WORDS, read_landmarks
from abfm_viewer.cli import options, results
from abfm_viewer.cli.match import Outputs, solve
from abfm_viewer.cli.progress import long_steps
from abfm_viewer.files import outputs

SUMMARY = "register one surface to another by functions on both"
_WORDS = "\n".join(f"  {word.form}\n      {word.about}" for word in WORDS)
_MEASURED = ", ".join(as_option(name, value) for name, value in MEASURED.changed().items())
DESCRIPTION = f"""\
Find where on surface A each point of surface B lies, so that the functions of A (--source), carried
to B, are as near to those of B (--target) as they can be: by an initial map, and then by the flow
of a vector field on B.

Examples:
  abfm register lh.sphere fsaverage.sphere.surf.gii --source file:lh.sulc --target file:avg.gii \\
      --mask-b cortex.csv --out sub-01_reg.npz
  abfm register pose1.off pose2.off --source hks:time=0.01 --target hks:time=0.01 --out reg.npz
  abfm register cat.off lion.off --landmarks pairs.csv --out reg.npz
  abfm apply sub-01_reg.npz --labels lh.aparc.annot --out aparc.label.gii

The initial map (--initial) is by default the best of the candidates that apply, which are compared
by how much they stretch the surfaces, by the descriptors and functions that they keep, and by
landmarks; a note reports the chosen one and the next one. Or it is one of
{_WORDS}
Functions that were measured, or have other units, are compared in standard deviations from their
means; one with the other sign is turned, with a note. These, and functions of two shapes whose map
was searched, are matched as far as left-out patches gain, with the parameters
{_MEASURED} unless given; others with those of `abfm match`.

The exit status is as of `abfm match`. It is 3 also if the initial map may lead elsewhere (a warning
reports why) or if the complete map from A to B has a larger residual than the flow on B. Measured
functions are registered if the residual is below {SHARE_REGISTERED:g} of that of the initial map
alone, and below {RESIDUAL_REGISTERED:g}.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = options.adder(parser)
    add("a", f"surface A, a {options.MESH}", "A")
    add("b", "surface B, on which the flow is", "B")
    options.add_mesh_options(parser)
    options.add_channels(
        parser, "function on A to bring to B", "function on B that it should become"
    )
    add = options.adder(parser.add_argument_group("what counts, and where it begins"))
    for side in "ab":
        add(
            f"--mask-{side}",
            f"how much vertices of {side.upper()} count, not negative: a function or its file",
            "SPEC",
        )
    add(
        "--landmarks",
        "pairs of vertices of A and of B, counted from 0, or of x, y, z on both, a pair a line; "
        "alone or with functions",
        "FILE.csv",
    )
    add("--one-based", "vertex numbers of --landmarks count from 1, not from 0")
    add("--initial", "the initial map, see above", "WORD[:...]")
    options.add_parameters(parser)
    add = options.adder(parser.add_argument_group("output"))
    add(
        "--out",
        "registration .npz; .gii or .ply with A's faces where they lie on B, such as a sphere.reg; "
        ".txt, .csv or .npy with A's vertex for each of B; .html for a browser: both surfaces, "
        "turning, with a time bar; repeatable",
        "FILE",
        type=Path,
        action="append",
        required=True,
    )
    options.add_up(add)
    options.add_max_distortion(add)
    add("--json", "print one JSON object about the result")
    add("--quiet", "no progress")


def run(arguments: argparse.Namespace) -> int:
    """Register and write; the status is that of `abfm match`."""
    sources, targets, weights = options.channels(
        arguments, may_lack=arguments.landmarks is not None
    )
    surfaces, masks = (arguments.a, arguments.b), (arguments.mask_a, arguments.mask_b)
    read = (*surfaces, *masks, arguments.initial, arguments.landmarks, *sources, *targets)
    for path in arguments.out:
        outputs.check_registered(path)
        outputs.check_not_read(path, read)
    changed = options.given_parameters(arguments)
    Parameters.of(**changed)  # refused before an initial map is looked for
    with long_steps(arguments.quiet):
        a, b = (options.mesh(arguments, path) for path in (arguments.a, arguments.b))
        prepared = prepare(
            a,
            b,
            sources or None,
            targets or None,
            initial=arguments.initial,
            landmarks=arguments.landmarks
            and read_landmarks(a, b, arguments.landmarks, arguments.one_based),
            mask_a=options.weight(a, arguments.mask_a),
            mask_b=options.weight(b, arguments.mask_b),
            weights=weights or None,
        )
    results.print_notes(prepared.notes)
    for warning in prepared.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    parameters = prepared.problem.parameters
    problem = prepared.problem.with_parameters(parameters.with_values(**changed))
    out = Outputs(arguments.out, up=arguments.up)
    outcome = solve(problem, out, arguments.quiet, arguments.max_distortion, prepared)
    outcome.print(arguments, "a", "b")
    return outcome.status
