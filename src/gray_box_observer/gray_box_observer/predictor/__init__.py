"""The LSTM that forecasts torque (thesis 4.3, 5.1). Read `forecasting.py` first."""

from gray_box_observer.predictor.alarm import AlarmSettings, ResidualAlarm
from gray_box_observer.predictor.forecasting import Forecasting
from gray_box_observer.predictor.network_inputs import Variant
from gray_box_observer.predictor.predictor import Predictor
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.rotor_predictor import RotorPredictor
from gray_box_observer.predictor.scores import Skill
from gray_box_observer.predictor.torque_predictor import Prediction, TorquePredictor
from gray_box_observer.predictor.training.training_backend import (
    InlineTraining,
    ProcessTraining,
    Training,
    TrainingProcess,
)

__all__ = [
    'AlarmSettings',
    'Forecasting',
    'InlineTraining',
    'Prediction',
    'Predictor',
    'ProcessTraining',
    'ResidualAlarm',
    'RotorPredictor',
    'Skill',
    'TorquePredictor',
    'Training',
    'TrainingProcess',
    'TrainingSettings',
    'Variant',
]
