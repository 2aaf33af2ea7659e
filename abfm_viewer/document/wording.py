"""Texts as sentences."""


def capital(text: str) -> str:
    """A text with a capital first letter, and the rest as it is: names of files keep theirs."""
    return text[:1].upper() + text[1:]


def sentence(text: str) -> str:
    """The same with a full stop."""
    return f"{capital(text)}."
