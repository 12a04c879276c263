"""Turns a drive's folder (model.c, drive.toml) into its .fmu."""
