from .correspondence import Correspondence as Correspondence
from .correspondence import load_correspondence as load_correspondence
from .register import prepare as prepare
from .register import register as register
from .registration import Registration as Registration
from .registration import load_registration as load_registration
