"""Pictures, tables and pages of records, which the packages for them draw and write."""

from typing import Any

from ...hooks import Hook

PLACE = "src/retrax/presentation.py"
histories: Hook[..., Any] = Hook(PLACE)  # of a record, as axes of Matplotlib
to_xarray: Hook[..., Any] = Hook(PLACE)
to_pandas: Hook[..., Any] = Hook(PLACE)
to_html: Hook[..., None] = Hook(PLACE)


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
        return histories(self, degrees=degrees)
