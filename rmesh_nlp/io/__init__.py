"""Files in and out: problem files, records, fields, meshes.

What other folders use of its modules:

- ``export``: Series, write_mesh, write_solution
- ``folder``: append_whole, folder_aside, Manifest, read_text, remove_leftovers, safe_name, write_text,
  write_whole
- ``kept_problem``
- ``problem_file``: load_problem, read_table, read_tables, read_toml, template
- ``problem_schema``: ProblemTable, Table
- ``problem_values``: as_list, expected, Flag, LARGEST, ObjectiveText, Seed, Text
- ``records``: DamagedRecordsWarning, ends_of, gain_of, has_energy, objective_of, parse_json, Record,
  REQUIRED, to_json
- ``results``: read_results, read_rows, RECORD, RECORDS, Result, Results, row_files, ROWS, SOLUTIONS,
  TABLES, write_history, write_single
- ``vtu``: Fields, MeshState, read_vtu, state_of
"""
