"""Motor drives as FMUs: the contract, the check before loading, the import. The only importer of fmpy."""
