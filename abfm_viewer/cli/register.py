"""`abfm register`: register one surface to another."""

import argparse

from abfm.matching import RESIDUAL_REGISTERED, SHARE_REGISTERED
from abfm.parameters import as_option
from abfm.registration import MEASURED
from abfm.registration.initial import WORDS
from abfm.registration.task import RegistrationTask
from abfm_viewer.cli import solve

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
_OUT = (
    "registration .npz; .gii or .ply with A's faces where they lie on B, such as a sphere.reg; "
    ".txt, .csv or .npy with A's vertex for each of B; .html for a browser: both surfaces, "
    "turning, with a time bar"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    solve.add_arguments(parser, RegistrationTask, _OUT)


def run(arguments: argparse.Namespace) -> int:
    return solve.run(arguments, RegistrationTask)
