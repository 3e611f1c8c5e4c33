from .exporting import export as export
from .writing import ExportReport as ExportReport
