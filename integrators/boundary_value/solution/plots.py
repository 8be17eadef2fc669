"""The method ``plot`` of a solution, of a batch and of phases."""

from typing import Any


class HistoryPlots:
    """A base of records that have histories of states and controls."""

    def plot(self, degrees: bool = False) -> Any:
        """The histories of states and controls as Matplotlib axes; see ``retrax.plotting.histories``.

        Parameters
        ----------
        degrees : bool
            Whether angles and their rates are drawn in degrees instead of radians.

        Returns
        -------
        ndarray of matplotlib axes
            One for each array of the state, then one for each array of the controls.
        """
        from ....plotting.histories import histories

        return histories(self, degrees=degrees)
