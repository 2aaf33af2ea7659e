"""
Match a descriptor between two poses.
====================================

The heat kernel signature of one function.
"""

import abfm
from abfm.assets import asset_path

mesh = abfm.load_mesh(asset_path("eight.off"))
match = abfm.match(mesh, "gaussian:vertex=10,width=0.25", "gaussian:vertex=30,width=0.25")
print(match.facts.headline)

# %%
# The field and the advected source.

match
