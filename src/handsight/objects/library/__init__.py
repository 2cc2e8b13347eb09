"""Objects by name, in a folder or at a URL."""

from handsight.objects.library.documents import Entry, Facts, NoLibrary
from handsight.objects.library.library import Library

__all__ = ["Entry", "Facts", "Library", "NoLibrary"]
