from .read import Store as Store
from .write import Source as Source
from .write import build_store as build_store
from .write import source_of_dataset as source_of_dataset
from .write import source_of_folder as source_of_folder
from .write import verify_store as verify_store
