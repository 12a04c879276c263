"""The engine of a Dask cluster, whose machines share a folder: runs go out as numbers, rows come back."""
