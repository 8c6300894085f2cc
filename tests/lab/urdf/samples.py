"""Small URDF files of our own: a tree with every kind of joint, and an arm of two rods in a plane."""

from __future__ import annotations

#: A trunk that turns, an arm with a skew axis and a gripper whose second finger mimics the first, and a wheel.
TREE = """<?xml version="1.0"?>
<robot name="tree">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="floor"/>
  <link name="trunk">
    <inertial>
      <origin xyz="0.01 -0.02 0.2" rpy="0.1 0.2 -0.3"/>
      <mass value="4.5"/>
      <inertia ixx="0.05" ixy="0.001" ixz="-0.002" iyy="0.06" iyz="0.003" izz="0.02"/>
    </inertial>
    <visual><geometry><mesh filename="package://nobody/trunk.stl"/></geometry></visual>
  </link>
  <joint name="waist" type="revolute">
    <parent link="floor"/><child link="trunk"/>
    <origin xyz="0 0 0.4" rpy="0 0 0.2"/><axis xyz="0 0 -1"/>
    <limit lower="-1.5" upper="1.25" effort="40" velocity="3"/>
    <dynamics damping="0.1" friction="0.02"/>
  </joint>
  <link name="arm">
    <inertial>
      <origin xyz="0 0 0.15"/><mass value="1.25"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.011" iyz="0" izz="0.002"/>
    </inertial>
  </link>
  <joint name="shoulder" type="continuous">
    <parent link="trunk"/><child link="arm"/>
    <origin xyz="0.1 0.05 0.35" rpy="0.4 -0.5 0.6"/><axis xyz="1 2 -2"/>
  </joint>
  <link name="hand">
    <inertial><mass value="0.5"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>
  </link>
  <joint name="wrist" type="fixed">
    <parent link="arm"/><child link="hand"/><origin xyz="0 0 0.3" rpy="0 1.5707963 0"/>
  </joint>
  <link name="finger">
    <inertial><origin xyz="0.02 0 0"/><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5"/></inertial>
  </link>
  <joint name="grip" type="prismatic">
    <parent link="hand"/><child link="finger"/><origin xyz="0 0.01 0"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="20" velocity="0.2"/>
  </joint>
  <link name="thumb">
    <inertial><origin xyz="0.02 0 0"/><mass value="0.06"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5"/></inertial>
  </link>
  <joint name="grip_too" type="prismatic">
    <parent link="hand"/><child link="thumb"/><origin xyz="0 -0.01 0"/><axis xyz="0.1 -1 0"/>
    <limit lower="-0.1" upper="0.1" effort="20" velocity="0.2"/><mimic joint="grip" multiplier="0.75" offset="0.003"/>
  </joint>
  <link name="tip"/>
  <joint name="curl" type="revolute">
    <parent link="finger"/><child link="tip"/><origin xyz="0.04 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/><mimic joint="shoulder" multiplier="-0.5" offset="0.3"/>
  </joint>
  <link name="wheel"><inertial><mass value="0.8"/><inertia ixx="2e-3" iyy="4e-3" izz="2e-3"/></inertial></link>
  <joint name="wheel" type="continuous">
    <parent link="floor"/><child link="wheel"/><origin xyz="0.2 0 0.1"/><axis xyz="0 1 0"/>
  </joint>
  <transmission name="passed_over"/>
</robot>
"""

#: Two rods without thickness in the x–z plane, turning about y: 2 kg, 0.4 m; 1 kg, 0.3 m; masses in their middles.
RODS = """<robot name="rods">
  <link name="base"/>
  <link name="upper">
    <inertial><origin xyz="0.2 0 0"/><mass value="2"/><inertia ixx="0" iyy="0.02" izz="0.02"/></inertial>
  </link>
  <link name="lower">
    <inertial><origin xyz="0.15 0 0"/><mass value="1"/><inertia ixx="0" iyy="0.0075" izz="0.0075"/></inertial>
  </link>
  <joint name="S" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
  <joint name="E" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" effort="10" velocity="4"/></joint>
  <link name="tip"/>
  <joint name="end" type="fixed"><parent link="lower"/><child link="tip"/><origin xyz="0.3 0 0"/></joint>
</robot>
"""

#: A platform that glides on a plane, and beside it one that floats, with an arm: each turned somewhere.
FREE = """<?xml version="1.0"?>
<robot name="free">
  <link name="world"/>
  <link name="ship"><inertial><origin xyz="0.1 0.2 -0.05"/><mass value="3"/>
    <inertia ixx="0.1" ixy="0.01" iyy="0.2" iyz="-0.01" izz="0.3"/></inertial></link>
  <joint name="sea" type="floating">
    <parent link="world"/><child link="ship"/><origin xyz="1 -2 0.5" rpy="0.3 -0.2 0.7"/>
  </joint>
  <link name="mast">
    <inertial><origin xyz="0 0 0.4"/><mass value="0.7"/><inertia ixx="0.02" iyy="0.02" izz="0.001"/></inertial></link>
  <joint name="boom" type="continuous">
    <parent link="ship"/><child link="mast"/><origin xyz="0.2 0 0.1" rpy="0 0.4 0"/><axis xyz="0 1 1"/>
  </joint>
  <link name="sled">
    <inertial><origin xyz="0 0.1 0.02"/><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.15"/></inertial></link>
  <joint name="floor" type="planar">
    <parent link="world"/><child link="sled"/><origin xyz="0 1 0" rpy="0.5 0 -0.3"/><axis xyz="0 0 1"/>
  </joint>
</robot>
"""
