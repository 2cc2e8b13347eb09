"""Pictures of corrections and of tracked recordings, and a page that shows a tracker or a recording at work.

Pictures need matplotlib, the page needs viser: each is imported when one is drawn.
"""

from handsight.viewer.live_viewer import NullViewer, Viewer, view

__all__ = ["NullViewer", "Viewer", "view"]
