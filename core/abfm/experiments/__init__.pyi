from .experiment import Experiment as Experiment
from .experiment import Measure as Measure
from .experiment import Setup as Setup
from .figures import FIGURES as FIGURES
from .figures import TITLES as TITLES
from .figures import experiment_of as experiment_of
from .set_up_apart import set_up_apart as set_up_apart
