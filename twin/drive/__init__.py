"""Motor drives as FMUs: the contract, the check before loading, the import. The only importer of fmpy."""

COMPILED = "compiled"
"""The cache folder of what was compiled of FMUs; here, for importing who compiles takes longer than to look there."""
