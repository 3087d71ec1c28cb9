"""The names that a file with your own effects imports, for `--effects` and `diagnose(..., effects=...)`.

from deltatwin.effects import Amplitude, Effect

@dataclass(frozen=True)
class Bump(Effect):
    height: Amplitude = Amplitude("N m", "height")
    name = "bump"
    settles = "a slow sweep"

    def regressors(self, scene, joint, nonlinear): ...
"""

from service.model.effects.base import Amplitude, Effect, Nonlinear

__all__ = ["Amplitude", "Effect", "Nonlinear"]
