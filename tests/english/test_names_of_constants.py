"""Check of the names of constants: nouns, one a line."""

import ast
import re

import pytest

# words that are not nouns; superlatives are also rejected
OTHER_WORDS = frozenset(
    re.findall(
        r"\w+",
        """
ABANDONED ABOUT ABOVE ACCEPTED ACROSS AFFORDABLE AFTER AGAIN AGREED ALIKE ALIVE ALL ALONE ALWAYS
AND ANEW ANY APART APPENDED AROUND AS ASIDE ASTRAY AT AVERAGED AWAY BAD BARE BASED BEFORE BEHIND
BELOW BENT BESIDE BETWEEN BEYOND BLANK BLOCKED BOTH BRIGHT BUNDLED BUT BY CALM CARRIED CHOSEN
CIRCULAR CLAMPED CLEAR CLICKABLE CLOSE CLOSER CLOSING COARSER COLDER COLLAPSED COLORED COMBINED
COMMUTING COMPARED COMPLEX COMPRESSED COMPUTING CONVERTIBLE CONVEX COOLER CORRECT COVERED
CREASED CRITICAL CUT DARK DENSE DESCRIBED DISTORTED DONE DOUBLE DOWN DRAWN DROPPED EACH EARLY
ENCLOSES ENDED ENDLESS ENOUGH EVERY EVERYTHING EXACT EXPECTED EXPLAINED FAILED FAINT FALLING FAR
FARTHER FAST FASTER FEW FILLED FINE FINER FIRST FLAT FOLDED FORGETS FOUND FREE FROM FULL FURTHER
GAINED GIVEN GO GOES GOING GOLDEN GONE GOOD GROWN HARDLY HAVE HELD IDLE IMPOSSIBLE IN INITIAL
INSIDE INWARD IS IT KEEPING KEPT LARGE LARGER LAST LASTING LATER LEAST LEFT LESS LINEAR LISTENED
LITTLE LOADING LONG LONGER LOOKED LOOSE LOST LOW MAIN MANY MARKED MATCHED MAX MEASURED MIN
MIRRORED MISSED MISSING MOLLIFIED MOST MOVING MUCH NAMED NARROW NEAR NEARER NEARLY NEGLIGIBLE
NEVER NEW NEXT NO NONE NONLINEAR NOTHING NOTICED NOW NUMBERED NUMERIC ODD OF OFF OFFSCREEN OFTEN
OLD ON ONCE ONE ONLY OPAQUE OPEN OPENED OPPOSITE OR OTHER OTHERS OURS OUT OUTSIDE OVER OWN
PAYING PER PLAIN PLEASANT POSITIVE PRESENT PRIMARY PROMINENT PULLED QUOTED READ RECENT REDUCED
REFINED REGISTERED RELATIVE RELAXED REPORTED RESOLVED RIVAL ROBUST ROUND ROUNDED SAME SAVING
SCREENED SCREENING SETTLED SEVERAL SHARP SHORT SHORTER SHOWN SHRUNK SIGNIFICANT SINGLE SLOW
SLOWER SMALL SMOOTH SMOOTHED SMOOTHER SOLVING SPANNED SPARED SPARSE SPECIAL SPECTRAL SQUARE
STANDARD STEEP STIFF STILL STRAIGHT STRETCHED SUBDIVIDED SUBMITTED SUDDENLY SYMMETRIC TAKEN TALL
TEXTURED THE THIN TIGHT TINY TO TOGETHER TOLD TOO TRUE TURNED UNEVEN UNFINISHED UNKNOWN
UNMATCHED UNNAMED UNSET UNSOLVED UNSTABLE UP UPRIGHT USUAL VANISHED VARIABLE WANTED WARM WHILE
WHOLE WIDE WILD WITH WITHOUT WITNESSED WORSE WORTH WRITTEN WRONG
""",
    )
)


def constants(statement):
    """Return names in capitals that a statement binds, but not from their earlier values."""
    if statement.value is None:
        return []
    names = [node for node in ast.walk(statement) if isinstance(node, ast.Name)]
    used = {name.id for name in names if isinstance(name.ctx, ast.Load)}
    bound = [name.id for name in names if isinstance(name.ctx, ast.Store)]
    return [name for name in bound if name.strip("_").isupper() and name not in used]


def faults(assignments):
    """Return the faults of constants of a module: adjectives, or two on one line."""
    found = []
    for statement in assignments:
        names = constants(statement)
        found += [f"{name} is not a noun" for name in names if is_not_noun(name)]
        if len(names) > 1 and not is_numbered(statement.value):
            found.append(f"{', '.join(names)} are on one line")
    return found


def is_not_noun(name):
    words = name.strip("_").split("_")
    return all(word in OTHER_WORDS or (len(word) > 4 and word.endswith("EST")) for word in words)


def is_numbered(value):
    """Return whether values are consecutive integers, or the result of one call."""
    if not isinstance(value, ast.Tuple):
        return True
    numbers = [getattr(each, "value", None) for each in value.elts]
    return numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_constants_are_nouns(modules):
    product = {path: module for path, module in modules.items() if path.parts[0] != "benchmarks"}
    found = {str(path): faults(module.assignments) for path, module in product.items()}
    assert {path: names for path, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("_LONGEST = 1", ["_LONGEST is not a noun"]),
        ("_MOST_SHOWN = 1", ["_MOST_SHOWN is not a noun"]),
        ("WIDTH, HEIGHT = 3, 5", ["WIDTH, HEIGHT are on one line"]),
        ("NODE, EDGE, FACE = 0, 1, 2\nLENGTHS = {}\nLENGTHS = LENGTHS | {1: 2}", []),
    ],
)
def test_faults_of_constants_are_found(text, expected):
    assert faults(ast.parse(text).body) == expected
