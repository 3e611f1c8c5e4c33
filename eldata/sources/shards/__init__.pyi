from .index import ShardError as ShardError
from .index import ShardIndex as ShardIndex
from .reading import verify_shards as verify_shards
from .writing import ShardReport as ShardReport
from .writing import write_shards as write_shards
