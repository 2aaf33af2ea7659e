from .line_integral import FloatImage as FloatImage
from .line_integral import line_integral_convolution as line_integral_convolution
from .texture_atlas import TextureAtlas as TextureAtlas
from .texture_atlas import texture_atlas as texture_atlas
