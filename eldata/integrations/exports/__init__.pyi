from .codes import export as export
from .hub import export_hub as export_hub
