"""The classroom page: a scene as one offline HTML file."""
