"""FMU import: checks before loading, instances, compiled steps. The only importer of fmpy; knows no robot."""

COMPILED_FOLDER = "compiled"
"""Cache folder of compiled FMU libraries; defined here, as importing the compiling module takes longer than a look."""
