"""What may differ between two runs of the same command, and what is written in its place."""

import re

NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
PER_RUN = r'(<th scope="row">(?:stepping|recording|times as fast as the real robot|[^<]*per tick)</th>)'
LASTED = r"stepping|writing|seconds|stepping_s|recording_s|real_time_factor|microseconds_per_step|cost\w*"

RULES: tuple[tuple[str, str], ...] = (
    # said only where code is not compiled yet
    (r"compiling, once: [^\n]*\n?", ""),
    # moments
    (r"\d{4}-\d\d-\d\d[ _T]\d\d:?\d\d(:?\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?", "TIME"),
    # how long it took, in text, JSON and pages
    (rf"{NUMBER} x real time", "N x real time"),
    (rf'("(?:{LASTED})": ){NUMBER}', r"\1N"),
    (r'"microseconds": \{[^}]*\}', '"microseconds": {N}'),
    (rf"{PER_RUN}(\s*<td>[^<]*</td>)+", r"\1<td>N</td>"),
    (rf'("cost": \{{"value": ){NUMBER}', r"\1N"),
    (rf"{NUMBER} us\b", "N us"),
    # the last column of twin drive compare and twin drive check --table, of the drives that the cases compare
    (rf"(?m)^((?:velocity_servo|pmsm_foc)  .*?) +{NUMBER}$", r"\1 N"),
    (rf"(?m)^(\| (?:modelica_dc|stepper) \|.*\|) {NUMBER} \|$", r"\1 N |"),
    # hashes of what machine code is in, of files of which each member is compared, and of places
    (r'(sha256\\?"? ?[=:] ?\\?")[0-9a-f]{64}', r"\1HASH"),
    (r"sha256 [0-9a-f]{12}\b", "sha256 HASH"),
    (r'("the sweep": ")[0-9a-f]{64}', r"\1HASH"),
    (rf"(?m)(sha256 HASH +){NUMBER}$", r"\1N"),
    (r"\| `[0-9a-f]{64}` \|", "| `HASH` |"),
    (r'((?:guid|instantiationToken)=")\{[0-9a-f-]+\}', r"\1{HASH}"),
    (r"(results/sweeps/\w+)-[0-9a-f]{8}\b", r"\1-HASH"),
    # what a run takes on the disk, with durations in its summary
    (r'"bytes": \d+', '"bytes": N'),
    # of the machine: what is free, what caches hold
    (rf"{NUMBER} (?=GB free)", "N "),
    (r"\d+ (FMUs?|files?|folders?|functions?|pieces of code), \d+ MB", r"N \1, N MB"),
)
"""Regular expressions, and what stands for what they find."""
PROGRESS: tuple[str, ...] = (
    r"(?m)^\S+ +[\d.]+ / [\d.]+ s(, .*)?\n",
    r"(?m)^(.+ )?\d+ of \d+ \w+(, .*)?\n",
    r"(?m)^.+ +\d+%( .* left)?\n",
    r"(?m)^(linking|compiling)\n",
    r"(?m)^[\d.]+ s +\d+ Hz +late .*\n",
)
"""Lines about how far it is, which a command without a terminal prints once a minute, to its error stream."""

DRAWN_OF_DURATIONS = ("convergence.png",)
"""Names of pictures that show how long something took."""


def normal(text: str) -> str:
    """`text` without what may differ."""
    for pattern, instead in RULES:
        text = re.sub(pattern, instead, text)
    return text


def normal_error(text: str) -> str:
    """`text` of an error stream: likewise, and without what says how far it is."""
    for pattern in PROGRESS:
        text = re.sub(pattern, "", text)
    return normal(text)
