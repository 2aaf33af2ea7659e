"""
Solve a batch on a Dask cluster
===============================

`abfm.solve_many` matches many problems on any executor, such as that of a Dask cluster. This
example compares values of a parameter on a small local cluster.
"""

from distributed import Client, LocalCluster

import abfm
from abfm.assets import asset_path
from abfm_viewer.pictures import match_picture

# %%
# The problems
# ------------
#
# A problem is a mesh, a source, a target and parameters. Its digest is the same on every machine,
# so it can name a file of results.

mesh = abfm.load_mesh(asset_path("eight.off"))
source = abfm.function(mesh, "gaussian:vertex=10,width=0.25")
target = abfm.function(mesh, "gaussian:vertex=30,width=0.25")
alphas = (0.01, 0.03, 0.1, 0.3)
problems = [
    abfm.Problem(mesh, source, target, abfm.Parameters(alpha=alpha, refine=0)) for alpha in alphas
]
print(f"{len(problems)} problems, the first is {problems[0].digest[:12]}")

# %%
# The cluster
# -----------
#
# A match uses one core, so each worker has one thread. For another cluster, give the client the
# address of its scheduler, as in ``Client("tcp://10.0.0.1:8786")``.

with (
    LocalCluster(2, processes=False, threads_per_worker=1, dashboard_address=None) as cluster,
    Client(cluster) as client,
):
    matches = list(abfm.solve_many(problems, client.get_executor()))

for alpha, match in zip(alphas, matches, strict=True):
    change = match.distortion().log2_area.mean
    print(f"alpha {alpha:<4}: {match.facts.headline}; mean |log2 J| {change:.2f}")

# %%
# The best match
# --------------
#
# Among the matches that reached their target, the best one has the smallest change of areas.

reached = [match for match in matches if match.facts.outcome.is_good]
best = min(reached, key=lambda match: match.distortion().log2_area.mean)
best

# %%

match_picture(best)
