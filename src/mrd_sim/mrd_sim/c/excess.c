    if (turns) {
        plain(s, f * dt, turning, 0.0, bend, between);
    }
    const double excess = simulator - plain(s, turns ? g * dt : dt, position, velocity, acceleration, current);
