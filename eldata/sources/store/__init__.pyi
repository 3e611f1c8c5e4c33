from .build import build_store as build_store
from .build import verify_store as verify_store
from .format import Store as Store
from .read import open_store as open_store
from .sources import Source as Source
from .sources import source_of_dataset as source_of_dataset
from .sources import source_of_folder as source_of_folder
