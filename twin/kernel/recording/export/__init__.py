"""Recordings for other tools: CSV, Parquet, MATLAB. SI throughout, every unit beside its number."""
