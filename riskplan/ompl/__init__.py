"""The only place that knows OMPL: risk as its validity checks, and planners built on it."""

from riskplan.ompl.validity import RiskMotionValidator, RiskStateValidityChecker

__all__ = ["RiskMotionValidator", "RiskStateValidityChecker"]
