"""
Follow a wave and its tracks
============================

A sequence is a function on a surface at several times. This example recovers the velocity of a
rotating wave on a sphere, and tracks the two spirals at the ends of the axis of rotation.
"""

import numpy as np
import trimesh

import abfm
from abfm_viewer.pictures import sequence_picture

# %%
# A wave with known velocity
# --------------------------
#
# The pattern rotates by 2 radians per second about an axis. The axis itself rotates by 1 radian per
# second about the z axis. There are eight frames, 0.04 s apart.

mesh = abfm.load_mesh(trimesh.creation.icosphere(subdivisions=3))
times = 0.04 * np.arange(8)


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    return trimesh.transformations.rotation_matrix(angle, axis)[:3, :3]


frames, angular_velocities = [], []
for time in times:
    wander = rotation([0, 0, 1], time)
    x, y, z = (mesh.vertices @ wander @ rotation([1, 0, 0], 2 * time)).T
    frames.append(np.hypot(y, z) * np.cos(2 * np.arctan2(z, y) + 2.5 * x))
    angular_velocities.append([0, 0, 1] + wander @ [2, 0, 0])

# %%
# The recovered velocity
# ----------------------
#
# The smoothness of the velocity depends on the parameters of a norm, which are given here. Without
# given parameters, abfm chooses those that best predict left-out patches of the frames.

parameters = abfm.sequences.defaults(alpha=1.0, sigma=0.1, order=1)
sequence = abfm.sequence(mesh, frames, times, parameters)
print(sequence.facts.headline)

centres = mesh.vertices[mesh.faces].mean(axis=1)
errors = []
for i, velocity in enumerate(sequence.velocity):
    omega = np.add(angular_velocities[i], angular_velocities[i + 1]) / 2
    truth = np.cross(omega, centres)
    errors.append(np.linalg.norm(velocity - truth) / np.linalg.norm(truth))
print(f"relative error of the velocity: {np.mean(errors):.3f}")
sequence

# %%
# The picture has three frames with arrows of the velocity. Arrows are faint where the frames do not
# determine the velocity.

sequence_picture(sequence, times[[0, 3, 7]].tolist())

# %%
# Tracks
# ------
#
# A track follows a critical point of the velocity through time. The true velocity vanishes at both
# ends of the axis of rotation.

for track in sequence.tracks():
    omega = np.array([np.interp(track.times, times, c) for c in np.transpose(angular_velocities)])
    axis = omega / np.linalg.norm(omega, axis=0)
    cosine = np.abs((track.points.positions * axis.T).sum(axis=1))
    angle = np.degrees(np.arccos(np.minimum(cosine, 1))).mean()
    print(f"{track.kind} in {len(track)} intervals, {angle:.1f} degrees from the axis")
