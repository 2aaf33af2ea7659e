from .open_window import open_window as open_window
from .window import Window as Window
