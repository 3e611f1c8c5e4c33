from .evaluate import evaluate as evaluate
from .predictions import EXTENSIONS as EXTENSIONS
from .predictions import load_prediction as load_prediction
from .predictions import save_prediction as save_prediction
from .results import EvaluationResult as EvaluationResult
from .results import ImageScore as ImageScore
