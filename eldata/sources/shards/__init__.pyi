from .index import ShardError as ShardError
from .reading import verify_shards as verify_shards
from .writing import write_shards as write_shards
