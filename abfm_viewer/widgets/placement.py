"""Places for tooltips and cards next to the widgets that they explain."""

from abfm_viewer.widgets.widget_record import Rect

Size = tuple[float, float]
_WIDTH_SHARE_MAX = 0.5  # of the window; wider areas have no useful space at their sides


def hull(*rects: Rect) -> Rect:
    lefts, tops, rights, bottoms = zip(*rects, strict=True)
    return min(lefts), min(tops), max(rights), max(bottoms)


def side_room(area: Rect, window: Rect) -> float:
    """Return the larger free width at the sides of an area."""
    return max(area[0] - window[0], window[2] - area[2])


def beside(
    item: Rect, area: Rect | None, window: Rect, size: Size, gap: float
) -> tuple[float, float]:
    """Return the top left corner of a text of this size that explains an item of an area.

    The text lies at the side of the area with more space, at the height of the item. It lies above
    a wide area, or else above or below the item. Without an area, the item is its own.
    """
    left, top, right, bottom = window
    width, height = size
    x = min(max(item[0], left), max(right - width, left))
    y = min(max(item[1], top), max(bottom - height, top))
    is_narrow = area is None or area[2] - area[0] <= _WIDTH_SHARE_MAX * (right - left)
    area = area or item
    if is_narrow and side_room(area, window) >= width + gap:
        is_left = area[0] - left > right - area[2]
        return (area[0] - gap - width if is_left else area[2] + gap), y
    for below in (area[1], item[1]):
        if below - gap - height >= top:
            return x, below - gap - height
    return x, min(item[3] + gap, max(bottom - height, top))
