    double plain[$states], excess;                      /* of the model alone; of the simulator beyond it */
    ${p}_vertex vertices[2];                           /* from ${p}_motion to ${p}_force */
    int count;
    double share, guess, answer;                       /* of the turning point; of the excess; of the model alone */
