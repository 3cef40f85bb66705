# SPDX-License-Identifier: Apache-2.0
"""An example that runs: a ball on a MuJoCo touch grid, read and decoded by a skin in every step."""

from __future__ import annotations

import numpy as np
import pytest

from dermis.skin import Skin

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (pip install mujoco; 74 MB unpacked)")

WORLD = """
<mujoco>
  <extension><plugin plugin="mujoco.sensor.touch_grid"/></extension>
  <option timestep="0.002"/>
  <worldbody>
    <body name="pad">
      <geom type="box" size="0.04 0.04 0.005"/>
      <site name="touch" pos="0 0 0.05"/>
    </body>
    <body pos="0.004 -0.003 0.02"><freejoint/><geom type="sphere" size="0.012" mass="0.4"/></body>
  </worldbody>
  <sensor>
    <plugin plugin="mujoco.sensor.touch_grid" objtype="site" objname="touch">
      <config key="size" value="16 16"/><config key="fov" value="45 45"/>
      <config key="gamma" value="0"/><config key="nchannel" value="1"/>
    </plugin>
  </sensor>
</mujoco>
"""


def test_a_ball_on_a_touch_grid_is_weighed() -> None:
    model = mujoco.MjModel.from_xml_string(WORLD)
    data = mujoco.MjData(model)
    skin = Skin("single_touch")
    for _ in range(500):
        mujoco.mj_step(model, data)
        touch = np.maximum(data.sensordata.reshape(16, 16), 0.0)
        codes = skin.read(touch, model.opt.timestep)
        found = skin.decode(codes, model.opt.timestep)
        full = codes == 255
        # Forces on the edge of an interval round by some 1e-15 either way.
        assert ((found.low_n <= touch * (1 + 1e-9)) & (touch <= found.high_n * (1 + 1e-9))).all()
        assert np.isinf(found.high_n[full]).all()
    # One taxel carries the ball, to half a code of 15 N / 255. Its neighbours are up to half a code too.
    assert found.force_n[touch > 0] == pytest.approx(touch[touch > 0], abs=0.03)
    assert touch.sum() == pytest.approx(0.4 * 9.81, rel=0.01)
    assert found.force_n.sum() == pytest.approx(touch.sum(), abs=0.09)
