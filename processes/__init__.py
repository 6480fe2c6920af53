"""What long work needs: worker processes, progress on stderr, deferred signals, silent C libraries.

Knows nothing of light or scenes, and imports no other package of NIGHT.
"""

from processes.deferred_signals import deferred_signals
from processes.progress import Progress, showing_progress
from processes.silence import silenced

__all__ = ["Progress", "deferred_signals", "showing_progress", "silenced"]
