"""Pictures, tables and pages of records, with packages that are imported when one is asked for."""

from typing import Any

from .integrators.reporting import presentation


def present_records() -> None:
    """Register what the methods of records call to draw and to write them."""
    presentation.histories.register(_histories)
    presentation.to_html.register(_to_html)
    presentation.to_pandas.register(_to_pandas)
    presentation.to_xarray.register(_to_xarray)


def _histories(record: Any, degrees: bool) -> Any:
    from .plotting.histories import histories

    return histories(record, degrees=degrees)


def _to_html(record: Any, *arguments: Any, **options: Any) -> None:
    from .plotting.page import to_html

    to_html(record, *arguments, **options)


def _to_pandas(record: Any, at: Any) -> Any:
    from .interop.tables import to_pandas

    return to_pandas(record, at)


def _to_xarray(record: Any) -> Any:
    from .interop.tables import to_xarray

    return to_xarray(record)
