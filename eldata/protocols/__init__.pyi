from .named import PROTOCOLS as PROTOCOLS
from .named import default_protocol as default_protocol
from .named import get_protocol as get_protocol
from .named import load_protocol as load_protocol
from .named import protocols_for as protocols_for
from .protocol import ClipProtocol as ClipProtocol
from .protocol import Protocol as Protocol
