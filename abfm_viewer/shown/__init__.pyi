from .streak_texture import streak_texture as streak_texture
