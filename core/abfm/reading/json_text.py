"""JSON of files, whose damage is told in plain words."""

import json
from typing import Any


def from_json(text: str | bytes) -> Any:
    """Return what a text in JSON holds.

    Raises
    ------
    ValueError
        If it is damaged, no text, nested too deeply, or has an integer of thousands of digits.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("its JSON is nested too deeply") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"its JSON is damaged in line {error.lineno}: {error.msg}") from None
    except UnicodeDecodeError:
        raise
    except ValueError:
        raise ValueError("its JSON has a number of too many digits") from None
