"""The engine of a Dask cluster: what runs stand on travels by content, runs travel as numbers."""
