"""Operations: what users ask for, and how it becomes requests to the line.

Read `drive_operations` (one drive) and `group_operations` (several, and the stop) first: every
face calls them. `requests` puts a request into the line and waits for its end, `request_maker`
gives every request its cost, `control_words` remembers what a quick stop must know, `reports` is
what users are told.
"""
