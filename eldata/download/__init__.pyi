from .fetching import RangeDownloader as RangeDownloader
from .installing import fetch_dataset as fetch_dataset
from .installing import unpack_dataset as unpack_dataset
from .overview import overview as overview
