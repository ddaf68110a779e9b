"""Pictures, pages and files of plans and episodes. Only methods that draw import this top layer of planners.

`pictures`, with matplotlib: `draw_overview` (`Solution.plot`), `draw_plan` (`plot_clearances`), `draw_search`.
`page.page`: `write_plan_page` (`Solution.to_html`), `write_page` (`TampExpert.to_html`).
`page.live`: `LivePage` (`TampExpert.live_page`). `mcap_file`: `write_mcap` (`Solution.to_mcap`).
"""
