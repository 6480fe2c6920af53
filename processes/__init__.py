"""What long work needs: worker processes, progress on stderr, and C libraries that print nothing.

Knows nothing of light or scenes, and imports no other package of NIGHT.
"""

from processes.progress import Progress, showing_progress
from processes.silence import silenced

__all__ = ["Progress", "showing_progress", "silenced"]
