"""Where frames come from: raw files, arrays, stores and shards."""
