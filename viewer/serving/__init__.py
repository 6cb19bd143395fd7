"""What a window shows, over HTTP: one page and one websocket a client, whom they are for, and how frames get there.

The server owns no OpenGL and knows no techniques: it tells a studio what clients want and sends what the studio shows.
"""
