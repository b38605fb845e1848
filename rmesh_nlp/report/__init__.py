"""Tables and figures from records; nothing is solved here.

What other folders use of its modules:

- ``blocks``: in_common_units
- ``figures``: figures
- ``histories``: with_common_costs
- ``html_page``: REPRODUCTION, write_report, write_reproduction
- ``pictures``: pictures
- ``study_summary``: is_study
- ``style``: Page, write
- ``tables``: frame, markdown, write_tables
"""
