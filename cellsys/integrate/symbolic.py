class CVODES: pass
class RungeKutta4: pass
