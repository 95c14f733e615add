"""Results as tables: one Parquet data set of runs, rows, cameras, seams, fiducials, components and views."""

from vaoi_station.plant.tables.data_set import write_tables
from vaoi_station.plant.tables.extraction import RunKey, Tables, result_tables
from vaoi_station.plant.tables.schema import TABLES, Column, arrow_schema

__all__ = ["TABLES", "Column", "RunKey", "Tables", "arrow_schema", "result_tables", "write_tables"]
