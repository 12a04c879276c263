model ModelicaDC "Separately excited direct-current motor with a heating armature"
  // The numbers in brackets are those of README.md.
  parameter Real R_0(unit = "Ohm") = 1.5 "Armature resistance at T_0";
  parameter Real L_a(unit = "H") = 1.5e-3 "Armature inductance";
  parameter Real R_f(unit = "Ohm") = 240 "Field resistance";
  parameter Real L_f(unit = "H") = 10 "Field inductance";
  parameter Real K(unit = "N.m/A2") = 1 "Torque per armature and field current";
  parameter Real J_m(unit = "kg.m2") = 1e-4 "Inertia of rotor, coupling and spring hub";
  parameter Real b_m(unit = "N.m.s/rad") = 1e-4 "Viscous friction";
  parameter Real tau_c(unit = "N.m") = 0.004 "Coulomb friction of bearings and brushes";
  parameter Real omega_c(unit = "rad/s") = 0.1 "Speed over which the Coulomb friction changes sign";
  parameter Real alpha(unit = "1/K") = 0.0039 "Rise of the armature resistance, of R_0";
  parameter Real T_0(unit = "K") = 293.15 "Temperature of the housing";
  parameter Real R_th(unit = "K/W") = 6 "Thermal resistance from armature to housing";
  parameter Real C_th(unit = "J/K") = 30 "Heat capacity of the armature";
  input Real v_a(unit = "V", start = 0) "Armature voltage";
  input Real v_f(unit = "V", start = 24) "Field voltage";
  input Real tau_load(unit = "N.m", start = 0) "Load; positive opposes positive omega_m";
  output Real theta_m(unit = "rad", start = 0, fixed = true) "Motor angle";
  output Real omega_m(unit = "rad/s", start = 0, fixed = true) "Motor speed";
  output Real i_a(unit = "A", start = 0, fixed = true) "Armature current";
  output Real T_w(unit = "K", start = 293.15, fixed = true) "Armature temperature";
  output Real tau_motor(unit = "N.m") "Torque in the air gap";
protected
  Real i_f(unit = "A", start = 0.1, fixed = true) "Field current";
  Real R_a(unit = "Ohm") "Armature resistance";
equation
  R_a = R_0*(1 + alpha*(T_w - T_0)); // (1)
  L_a*der(i_a) = v_a - R_a*i_a - K*i_f*omega_m; // (2)
  L_f*der(i_f) = v_f - R_f*i_f; // (3)
  tau_motor = K*i_f*i_a; // (4)
  J_m*der(omega_m) = tau_motor - tau_load - b_m*omega_m - tau_c*tanh(omega_m/omega_c); // (5)
  der(theta_m) = omega_m; // (6)
  C_th*der(T_w) = R_a*i_a*i_a - (T_w - T_0)/R_th; // (7)
end ModelicaDC;
