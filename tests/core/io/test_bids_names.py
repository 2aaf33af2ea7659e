import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm.errors import ParameterError
from abfm.io import bids_name, parse_bids_name
from abfm.io.bids_names import ENTITIES
from abfm.reading import hemisphere
from tests.messages import raises

words = st.text("0123456789abcXYZ", min_size=1, max_size=8)
entities = st.dictionaries(st.sampled_from(ENTITIES), words, min_size=1, max_size=8)
extensions = st.sampled_from([".surf.gii", ".nii.gz", ".json", ".label.gii"])


@given(entities=entities, suffix=words, extension=extensions, folder=words)
def test_bids_name_round_trip(entities, suffix, extension, folder):
    name = bids_name("a", suffix=suffix, extension=extension, **entities)
    said = parse_bids_name(f"{folder}_b-c/{name}")
    assert said == (entities, suffix, extension)
    places = [ENTITIES.index(key) for key in said.entities]
    assert places == sorted(places)
    assert bids_name(name) == name


@given(first=entities, second=entities, suffix=words)
def test_arguments_replace_parts_of_the_source(first, second, suffix):
    source = bids_name("a", suffix=suffix, extension=".surf.gii", **first)
    name = bids_name(source, extension=".func.gii", **second)
    assert parse_bids_name(name) == (first | second, suffix, ".func.gii")
    removed = dict.fromkeys(second)
    left = {key: value for key, value in first.items() if key not in second}
    if left:
        assert parse_bids_name(bids_name(source, **removed)).entities == left
    else:
        with raises(ParameterError):
            bids_name(source, **removed)


@given(name=st.text(max_size=30))
def test_any_name_is_parsed_or_none(name):
    said = parse_bids_name(name.replace("/", "_"))
    if said:
        pairs = [f"{key}-{value}" for key, value in said.entities.items()]
        assert "_".join([*pairs, said.suffix]) + said.extension == name.replace("/", "_")


@pytest.mark.parametrize(
    ("source", "given", "expected"),
    [
        (
            "out/sub-01_hemi-L_white.surf.gii",
            {"suffix": "sphere", "space": "fsaverage", "desc": "abfm"},
            "sub-01_hemi-L_space-fsaverage_desc-abfm_sphere.surf.gii",
        ),
        ("rh.sulc", {"extension": ".shape.gii", "sub": "01"}, "sub-01_hemi-R_sulc.shape.gii"),
        (
            "100307.L.midthickness.32k_fs_LR.surf.gii",
            {"sub": 100307, "den": "32k", "suffix": "midthickness"},
            "sub-100307_hemi-L_den-32k_midthickness.surf.gii",
        ),
        # entities that are not of BIDS precede the description
        ("sub-1_desc-a_atlas-b_x.label.gii", {"res": 2}, "sub-1_res-2_atlas-b_desc-a_x.label.gii"),
        ("tpl-fsaverage_hemi-R_sphere.surf.gii", {"hemi": None}, "tpl-fsaverage_sphere.surf.gii"),
        ("a.npy", {"sub": "a", "suffix": "x", "extension": ".tsv"}, "sub-a_x.tsv"),
    ],
)
def test_other_names_are_converted(source, given, expected):
    assert bids_name(source, **given) == expected


@pytest.mark.parametrize(
    ("source", "given", "named"),
    [
        ("a.npy", {"sub": "01"}, ("sphere", "BIDS")),
        ("lh.white", {}, (".surf.gii", "BIDS")),
        ("a.npy", {"suffix": "x", "extension": ".npy"}, ("a.npy",)),
        ("a.npy", {"sub": "0_1"}, ("0_1", "BIDS")),
        ("a.npy", {"sub": ""}, ("BIDS",)),
        ("a.npy", {"sbu": "1"}, ("sbu", "sub", "BIDS")),
        ("a.npy", {"sub": 1, "suffix": "a-b"}, ("a-b", "BIDS")),
        ("a.npy", {"sub": 1, "suffix": "a", "extension": "gii"}, ("gii",)),
    ],
)
def test_invalid_names_are_refused(source, given, named):
    with raises(ParameterError, *named):
        bids_name(source, **given)


@pytest.mark.parametrize(
    ("name", "side"),
    [
        *(("lh.white", "L"), ("rh.sphere.reg", "R"), ("surf/lh.aparc.annot", "L")),
        *(("sub-01_hemi-R_white.surf.gii", "R"), ("sub-L_hemi-R_white.surf.gii", "R")),
        *(("100307.L.white_MSMAll.32k_fs_LR.surf.gii", "L"), ("pial_left.gii.gz", "L")),
        *(("sulc.right.gii.gz", "R"), ("CORTEX_RIGHT.surf.gii", "R"), ("L.sphere.gii", "L")),
        *(("human.off", None), ("fs_LR.surf.gii", None), ("lh_to_rh.npy", None)),
        *(("lh/a.off", None), ("sub-left_T1w.nii.gz", None), ("r.l.off", None), ("", None)),
        *(("upright.off", None), ("hemi-X_L.gii", None)),
    ],
)
def test_hemisphere_is_read_from_the_name(name, side):
    assert hemisphere(name) == side
