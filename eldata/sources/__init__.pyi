from . import shards as shards
from . import store as store
