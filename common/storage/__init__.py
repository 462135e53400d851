"""Files of every stage: text read whole, files written whole or not at all, each with a hash of its content.

`files.py` (writing and cache keys), `cache.py` (the cache), `unfinished.py` (hidden folders of what is being written),
`seal.py` (hashes inside files), `text_file.py` (TOML) and `netcdf.py` (data).
"""
