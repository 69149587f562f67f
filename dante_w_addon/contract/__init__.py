"""What add-on and backend agree on. The modules of this package are the backend's own files, `dante_w/contract`."""

from ..layout import backend_folder

__path__ = [str(backend_folder() / "dante_w" / "contract")]
