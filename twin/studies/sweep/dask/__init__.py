"""The engine of a Dask cluster: files that runs need are sent by content, runs as numbers."""
