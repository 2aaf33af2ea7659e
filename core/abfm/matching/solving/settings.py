"""The constants of the continuation, each with its evidence.

Sections in quotation marks are those of docs/convergence.md; "41 problems" are those of its table
"What each part is worth", each of which both checks confirm with the values below.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ContinuationSettings:
    """What steers the continuation and is no parameter of the user."""

    # residual at which the norm of the search has found the target: "A norm that reaches far"
    found_residual: float = 0.75
    # of alpha, in the second variant of measured functions: with an earlier choice of sigma, a
    # cortex correlates to 0.923 with this variant, to 0.905 without it
    second_alpha_share: float = 1 / 3
    # times the user's sigma, where landmarks alone are matched: they need no search
    landmark_sigma_factors: tuple[float, ...] = (100.0, 10.0, 1.0)
    # times the last landmark_sigma that a path begins with, and the power of sigma with which it
    # falls: faster than sigma, so that landmarks lead
    landmark_factor_max: float = 100.0
    landmark_power: float = 2.0

    # a step ends when the energy falls by less than this share within so many iterations: with 1%
    # 39 of 41 problems are confirmed, with 12 iterations 40 in 1.4 times the time
    fall_min: float = 0.03
    fall_iterations: int = 6
    # sigma below which alpha falls as its square: if it never falls, 39 of 41 problems are
    # confirmed, in 1.6 times the time
    stiff_sigma: float = 0.05
    # of the goal, at which a step ends, as flow lines seldom confirm as much: with 1 (and no bound
    # of the work of finer meshes) 41 problems take 1.4 times the time
    goal_share: float = 0.8
    # of all iterations, before the mesh itself: nothing is lost on 67 problems, and runs of few
    # iterations reach their mesh
    coarse_iteration_share: float = 0.75
    # times the goal by the discrete flow, up to which a correction gains: without this bound a body
    # takes 781 iterations, not 641, to the same end
    correction_factor_max: float = 1.6

    # vertices of the coarsest mesh, and the ratio of vertices of consecutive meshes: "From coarse
    # to fine"
    coarsest_vertices: int = 2500
    level_ratio: float = 4.0
    # times the coarsest mesh's vertices, below which a mesh is solved on itself alone: 7,500
    coarsening_factor_min: float = 3.0
    # edges that features of functions span at least on a coarser mesh: what it does not resolve
    # would come back distorted
    feature_edges_min: float = 3.0
    # of all iterations without clusters, in iterations with clusters: "Thin triangles"
    cluster_cost_max: float = 2.0
    # iterations without clusters that are always spent
    exact_iterations_min: int = 2
    # a field of a coarser mesh is calm if it leaves no more than so many times the residual there
    # plus so much: more is not the field's doing
    stable_factor: float = 2.0
    stable_residual: float = 0.4
    # edges over which fields are smoothed until they are calm, and while that lowers the energy:
    # their kinks over coarse edges multiply the energy in the norm of second order by hundreds
    smoothing_edges: tuple[float, ...] = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)

    # vertices of the finest mesh, and products of rows on all finer meshes, about a minute, unless
    # the user asks for them: "Finer meshes"
    refined_vertices_max: int = 60_000
    refinement_effort_max: float = 5e9
    # iterations on a finer mesh that have to be within that effort
    refinement_iterations_min: int = 20

    # residual of a start beyond which the target is searched again
    lost_residual: float = 0.3
    # times the residual without motion, beyond which no search begins at a start
    astray_factor: float = 3.0
    # times the source's values, beyond which squares round off what the target is
    unstable_factor: float = 1e8

    # of advection in a descent, which sees no more; the gradient is exact for any tolerance
    advection_tolerance: float = 1e-7
    # iterations after which the curvature of landmarks is computed again, next to functions
    curvature_iterations: int = 10
    # numbers kept of that curvature: memory
    curvature_size_max: float = 5e7

    # patches and folds of the surface: 40 patches have errors that are 1.10 times as large
    patches: int = 150
    folds: int = 3
    # weight of the mean ``|log2 J|`` in the score of a step, relative to the held-out residual:
    # of 32 known flows the errors are 1.10 times the least, with 0.3 and 0.2 by the discrete flow
    # 1.19 and 1.23 times
    area_price: float = 0.25
    # a fold goes on while its energy falls by this share within so many iterations: all folds take
    # 1.5 times the evaluations of the steps, and the chosen sigma moves by 1 to 2% on a cortex
    fold_fall_min: float = 0.2
    fold_iterations: int = 4

    # vertices from which flow lines start, of evenly chosen faces: "Flows that hold"
    flow_line_vertices_max: int = 20_000
    # faces that are cut into parts to look for folds: fewer than before, as nothing was lost
    cut_faces_max: int = 64
    # iterations after which whatever moves has moved: no warning before
    warning_iterations_min: int = 10


SETTINGS = ContinuationSettings()
