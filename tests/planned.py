"""Tags of a user's own that the planner opens."""

from processes import SMALL

from pipelines.view import UNSAVED as BEGIN

LANDMARKS = """id,x,y,z,nx,ny,nz,note
7,2,5,1,0,-1,0,by the door
3,5,5,1,0,-1,0,
9,0,1,3,1,0,0,
4,3,5,5,0,-1,0,
"""
SETTINGS = (*SMALL[:2], "tag.edge=0.15", "objective.n=1", "objective.thold_p=0.1", "deployment=file")
UNSAVED = f"{BEGIN}.csv"
