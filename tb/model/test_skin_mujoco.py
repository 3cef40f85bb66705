# SPDX-License-Identifier: Apache-2.0
"""An example that runs: a ball and a box on a MuJoCo touch grid, read and decoded by a skin in every step."""

from __future__ import annotations

import numpy as np
import pytest

from dermis.skin import Skin

pytestmark = pytest.mark.long  # `make test LONG=1` installs mujoco
mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (pip install mujoco; 64 MB unpacked)")

BALL_N, BOX_N = 0.4 * 9.81, 1.6 * 9.81
WORLD = """
<mujoco>
  <extension><plugin plugin="mujoco.sensor.touch_grid"/></extension>
  <option timestep="0.002"/>
  <worldbody>
    <body name="pad">
      <geom type="box" size="0.04 0.04 0.005"/>
      <site name="touch" pos="0 0 0.05"/>
    </body>
    <body pos="-0.014 -0.013 0.018"><freejoint/><geom type="sphere" size="0.012" mass="0.4"/></body>
    <body pos="0.015 0.011 0.012"><freejoint/><geom type="box" size="0.011 0.009 0.006" mass="1.6"/></body>
  </worldbody>
  <sensor>
    <plugin plugin="mujoco.sensor.touch_grid" objtype="site" objname="touch">
      <config key="size" value="16 16"/><config key="fov" value="45 45"/>
      <config key="gamma" value="0"/><config key="nchannel" value="1"/>
    </plugin>
  </sensor>
</mujoco>
"""


def test_a_ball_and_a_box_on_a_touch_grid_are_weighed() -> None:
    model = mujoco.MjModel.from_xml_string(WORLD)
    data = mujoco.MjData(model)
    skin = Skin("single_touch")
    for _ in range(500):
        mujoco.mj_step(model, data)
        # Contacts push; the sign of the grid's normal differs between versions.
        touch = np.abs(data.sensordata.reshape(16, 16))
        codes = skin.read(touch, model.opt.timestep)
        found = skin.decode(codes, model.opt.timestep)
        full = codes == 255
        # Forces on the edge of an interval round by some 1e-15 either way.
        assert ((found.low_n <= touch * (1 + 1e-9)) & (touch <= found.high_n * (1 + 1e-9))).all()
        assert np.isinf(found.high_n[full]).all()
    # A point of the ball and four corners of the box, each to half a code of 15 N / 255.
    assert (touch > 0.1).sum() == 5
    assert found.force_n[touch > 0.1] == pytest.approx(touch[touch > 0.1], abs=0.03)
    assert touch.sum() == pytest.approx(BALL_N + BOX_N, rel=0.01)
    # Neighbours in the rows and columns of a contact read up to a code.
    assert found.force_n.sum() == pytest.approx(touch.sum(), abs=0.03 * (codes > 0).sum())
