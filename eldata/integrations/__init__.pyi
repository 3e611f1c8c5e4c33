from . import basicsr as basicsr
from . import exports as exports
from . import lightning as lightning
from . import torchmetrics as torchmetrics
