from .control import Control as Control
