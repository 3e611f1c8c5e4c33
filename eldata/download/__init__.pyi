from .fetching import RangeDownloader as RangeDownloader
from .fetching import fetch_archive as fetch_archive
from .installing import unpack_dataset as unpack_dataset
from .overview import overview as overview
