
/*
 * The same with a simulator that answers to the motion and the current that the effects before the damper leave:
 * ${p}_motion advances the damper to a sample, and fills in this motion and current; ${p}_force takes the force with which the
 * simulator answers, and returns the measured one. Elements in series, such as a play, give way under the force of the model
 * that stands for the simulator, and of what the simulator had beyond the model at the samples before (guess in the state).
 */
void ${p}_motion(
    ${p}_state *s, double dt, double position, double velocity, double acceleration, double current, double left[4]);
double ${p}_force(${p}_state *s, double simulator);
