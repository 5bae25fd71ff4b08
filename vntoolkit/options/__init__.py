"""Option types and enums of all verbs, below all stages: no algorithm is imported to name an option.

An option class is a frozen, keyword-only dataclass. The docstring beneath a field is its help on the command
line, and its annotation says its range. Stages take these classes as they are.
"""
