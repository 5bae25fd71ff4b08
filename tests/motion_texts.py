"""Small good files of motion capture: two frames of two or three joints, as BVH and as ASF with AMC."""

BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 1 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Chest
  {
    OFFSET 0 1 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 0 1 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.01
1 2 3 0 0 0 90 0 0
1 2 3 0 0 0 0 0 90
"""

ASF = """:version 1.10
:name test
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name spine
    direction 0 1 0
    length 2
    axis 0 0 30 XYZ
    dof rx rz
    limits (-1 1)
           (-1 1)
  end
  begin
    id 2
    name head
    direction 0 1 0
    length 1
    axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root spine
    spine head
  end
"""

AMC = """#comment
:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 0 0 0
spine 10 20
2
root 1 2 3 0 0 0
spine 10 20
"""
