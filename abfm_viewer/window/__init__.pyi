from .window import Window as Window
from .window import open_window as open_window
