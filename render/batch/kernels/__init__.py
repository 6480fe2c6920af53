"""DrJit kernels of the batched engine. Import the modules after a Mitsuba variant is set.

Every lane sums over points of its own scene only, in their order: a result does not depend on the other
scenes of a batch. Nothing here is a dataclass, because DrJit would take its fields for variables of loops.
"""
