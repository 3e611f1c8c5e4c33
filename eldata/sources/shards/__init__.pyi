from .checks import verify_shards as verify_shards
from .layout import ShardError as ShardError
from .layout import ShardIndex as ShardIndex
from .writing import ShardReport as ShardReport
from .writing import write_shards as write_shards
