from .door import LARGEST as LARGEST
from .door import array_from as array_from
from .door import from_json as from_json
from .door import inflated as inflated
from .door import most_inflated as most_inflated
from .door import open_plain as open_plain
from .door import read_bytes as read_bytes
from .gifti import gifti_arrays as gifti_arrays
