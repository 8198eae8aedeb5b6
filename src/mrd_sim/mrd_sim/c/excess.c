    if (count > 1) {
        plain(s, p);
    }
    const double excess = simulator - plain(s, p + count - 1);
