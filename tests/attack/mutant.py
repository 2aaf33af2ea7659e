"""One mutated file for each seed."""

from __future__ import annotations

import gzip
import zlib
from dataclasses import replace
from random import Random

from tests.attack import mutating, mutating_arrays, mutating_trees
from tests.attack.mutating import Mutation
from tests.attack.specimens import Specimen, specimens

_FITTING: dict[str, tuple[Mutation, ...]] = {
    ".npy": (mutating_arrays.npy,) * 3,
    ".npz": (mutating_arrays.members,) * 3
    + (mutating_arrays.directory, mutating_arrays.overlapping),
    ".abfm": (mutating_arrays.members,) * 2
    + (mutating_arrays.json_member,) * 3
    + (mutating_arrays.directory, mutating_arrays.overlapping),
    ".gii": (mutating_trees.xml,) * 3,
    ".gltf": (mutating_trees.json_text,) * 3,
    ".glb": (mutating_trees.glb,) * 3,
    ".json": (mutating_trees.json_text,) * 2,
    ".spec": (mutating.numbers, mutating.words),
}
_LARGEST = 2 << 20
_FREQUENT = {
    "project": 3,
    "result": 5,
    "map": 1,
    "values": 1,
    "mesh": 1,
    "recent": 1,
    "preferences": 1,
    "spec": 1,
}


def mutant(seed: int) -> tuple[Specimen, str]:
    """The mutant of a seed, always the same, and what was done to which specimen."""
    random = Random(seed)
    known = specimens()
    names = [name for name, specimen in known.items() for _ in range(_FREQUENT[specimen.door])]
    specimen = known[random.choice(names)]
    suffix = "." + specimen.name.removesuffix(".gz").rpartition(".")[2]
    choice = (
        (*mutating.ANY, *_FITTING.get(suffix, ()))
        if random.random() < 0.5
        else _FITTING.get(suffix, mutating.ANY)
    )
    done, content, beside = [], specimen.content, dict(specimen.beside)
    packed = specimen.name.endswith(".gz") and random.random() < 0.8
    if packed:
        content = gzip.decompress(content)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        mutation = random.choice(choice)
        if beside and random.random() < 0.4:
            name = random.choice(sorted(beside))
            beside[name] = random.choice(mutating.ANY)(random, beside[name])[:_LARGEST]
        else:
            content = mutation(random, content)[:_LARGEST]
        done.append(mutation.__name__)
    if packed:
        content = (
            gzip.compress(content, mtime=0) if random.random() < 0.9 else zlib.compress(content)
        )
    return replace(specimen, content=content, beside=beside), f"{specimen.name} {'+'.join(done)}"
