from .fetching import Fetcher as Fetcher
from .fetching import Patience as Patience
from .installing import fetch_dataset as fetch_dataset
from .installing import unpack_dataset as unpack_dataset
from .overview import overview as overview
