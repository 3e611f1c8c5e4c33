from . import basicsr as basicsr
from . import torchmetrics as torchmetrics
