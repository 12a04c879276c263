"""The engine of a Dask cluster: files that runs need are sent once, runs as numbers."""
