"""
Register a left to a right cortex
=================================

The two hemispheres of a brain are nearly mirror images of each other. This example registers the
left cortex of fsaverage5 to the right one by sulcal depth, and checks the map by curvature.
"""

import numpy as np
from nilearn.datasets import load_fsaverage, load_fsaverage_data

import abfm
from abfm.display import ViewSpec
from abfm.io.sheets import Panel, Sheet, Values
from abfm_viewer.pictures import figure_picture

# %%
# Surfaces and functions
# ----------------------
#
# nilearn contains fsaverage5, so nothing is downloaded. Both spheres have 10,242 vertices. The
# sulcal depth guides the registration, and the curvature is held out.

spheres = load_fsaverage("fsaverage5")["sphere"]
left, right = (abfm.load_mesh(spheres.parts[side]) for side in ("left", "right"))
depth = load_fsaverage_data("fsaverage5", data_type="sulcal").data.parts
curvature = load_fsaverage_data("fsaverage5", data_type="curvature").data.parts

# %%
# Registration
# ------------
#
# The initial map reflects the left sphere and rotates it to the right sphere. The flow then moves
# the sulcal depth of the left hemisphere on the right sphere.

registration = abfm.register(left, right, depth["left"], depth["right"], initial="sphere:mirror")
print(registration.facts.headline)
registration

# %%
# Measured quality
# ----------------
#
# The registration used the sulcal depth only, so the correlation of the curvature is an independent
# check. The distortion is the mean of :math:`|\log_2 J|` and of :math:`|\log_2 R|`. J is the change
# of area of a face and R the change of its shape. A value of 1 is a factor of 2.


def correlation(name: str, values: dict[str, np.ndarray]) -> None:
    """Print the correlation of a function with the target, before and after registration."""
    maps = (registration.initial, registration)
    before, after = (
        np.corrcoef(each.transfer(values["left"]), values["right"])[0, 1] for each in maps
    )
    print(f"{name}: correlation {before:.3f} by the initial map, {after:.3f} registered")


correlation("sulcal depth", depth)
correlation("curvature   ", curvature)
distortion = registration.distortion()
print(f"mean |log2 J| {distortion.log2_area.mean:.3f}")
print(f"mean |log2 R| {distortion.log2_shape.mean:.3f}")
print(f"folded faces: {distortion.folded}")

# %%
# The picture shows the depth on the inflated right hemisphere. The depth of the left hemisphere is
# transferred to it by the initial map and by the registration.

inflated = abfm.load_mesh(load_fsaverage("fsaverage5")["inflated"].parts["right"])
drawn = {
    "left, initial map": registration.initial.transfer(depth["left"]),
    "left, registered": registration.transfer(depth["left"]),
    "right": depth["right"],
}
panels = [Panel(inflated, Values(each, "sulcal depth"), label) for label, each in drawn.items()]
figure_picture(Sheet((tuple(panels),), view=ViewSpec(up="z")))
