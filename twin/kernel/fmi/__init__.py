"""FMU import: the check before loading, the instances, the compiled steps. The only importer of fmpy.

Three files know what a motor drive or another part of the robot is: `contract`, `mapping`, `sampled`. All others know
FMUs alone.
"""

COMPILED_FOLDER = "compiled"
"""The cache folder of what was compiled of FMUs; here, for importing who compiles takes longer than to look there."""
