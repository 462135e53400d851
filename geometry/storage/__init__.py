"""Files of every stage: text read whole, files written whole or not at all, each with a hash of its content.

`files.py` (writing, cache keys and the cache's folder), `unfinished.py` (hidden folders of what is being written),
`seal.py` (hashes inside files), `text_file.py` (TOML), `netcdf.py` and `zarr_folder.py` (the formats of data).
"""
