"""Pictures of the gallery: an image at the end of a cell is shown on the page, as in a notebook."""

from typing import Any

from PIL.Image import Image
from sphinx_gallery.scrapers import figure_rst


def save_image(block: object, block_vars: dict[str, Any], conf: dict[str, Any]) -> str:
    """Save the image that a cell returns, and return its reST; an empty text for other results."""
    image = block_vars["example_globals"].get("___")  # the last expression of this or an older cell
    if not isinstance(image, Image) or image is block_vars.get("saved_image"):
        return ""
    block_vars["saved_image"] = image
    path = next(block_vars["image_path_iterator"])
    image.save(path)
    return str(figure_rst([path], conf["src_dir"]))
