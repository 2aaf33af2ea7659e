from .line_integral import line_integral_convolution as line_integral_convolution
from .texels import FloatImage as FloatImage
from .texture_atlas import TextureAtlas as TextureAtlas
from .texture_atlas import texture_atlas as texture_atlas
